"""The bushing: exact torque of a turned one, the section against the body, axial and radial."""

from __future__ import annotations

from itertools import pairwise
from math import log2, pi

import pytest

import fem_snh

NU = 0.49999


def load(**options):
    """The force and the moment on the inner sleeve at the end."""
    result = fem_snh.run("bushing", progress=False, **options)
    assert result.converged, result.status
    row = result.steps[-1]
    assert row["reactions"]["outer"][1] == pytest.approx(-row["reactions"]["inner"][1], abs=1e-4)
    return row["reactions"]["inner"], row["moments"]["inner"]


def exact(length, angle):
    """The torque 4 pi mu L angle / (1/a^2 - 1/b^2) of mu r dtheta/dr = M / (2 pi r^2 L)."""
    mu = 3.0 / 2 / (1 + NU)
    return 4 * pi * mu * length * angle / (10**-2 - 20**-2)


def orders(errors):
    assert min(errors) > 0
    return [log2(a / b) for a, b in pairwise(errors)]


@pytest.mark.one_debian
def test_azimuthal_shear_of_a_section_is_exact_at_finite_angles():
    turned = {"kinematics": "plane_strain", "nu": NU, "radial": 0.0, "angle": 0.5}
    found = [load(cells=n, **turned)[1][2] / exact(1, 0.5) - 1 for n in (2, 4, 8)]
    assert found[-1] < 5e-5
    assert min(orders(found)) > 3


@pytest.mark.one_debian
def test_combined_section_is_the_body_within_its_error():
    """Torsion and tension; the difference is a hundredth of the body's error."""
    (_, fine, _), (_, fine_moment, _) = load(cells=8)
    (_, flat, _), (_, flat_moment, _) = load(cells=2)
    (_, solid, _), (_, solid_moment, _) = load(cells=2, kinematics="3D")
    assert abs(solid - flat) < 0.01 * abs(solid - fine)
    assert abs(solid_moment - flat_moment) < 0.03 * abs(solid_moment - fine_moment)
