"""The bushing: exact torque of a turned one, the section against the body, axial and radial."""

from __future__ import annotations

from itertools import pairwise
from math import log2, pi

import pytest

import fem_snh
from fem_snh.errors import BadInput

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


@pytest.mark.one_debian
def test_radial_section_is_pushed_back():
    """Along its path, and equally for every direction of it; it stiffens."""
    forces = [load(kinematics="plane_strain", angle=0.0, radial=r)[0] for r in (-2.0, 1.0, 2.0)]
    assert forces[0][0] == pytest.approx(-forces[2][0], rel=1e-6)
    assert max(abs(force[1]) for force in forces) < 1e-5
    assert forces[2][0] > 2 * forces[1][0] > 0


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"kinematics": "axisymmetric"}, "kinematics = 'axisymmetric': expected one of"),
        ({"kinematics": "plane_strain", "axial": 1.0}, "axial = 1.0: expected 0 with"),
        ({"radial": 1.0}, "radial = 1.0: expected 0 with"),
    ],
)
def test_mistakes_are_one_line(given, message):
    with pytest.raises(BadInput, match=message):
        fem_snh.run("bushing", progress=False, **given)
