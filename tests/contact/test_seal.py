"""An O-ring between two plates with friction: it converges, and the forces are in equilibrium."""

from __future__ import annotations

import pytest

import fem_snh


def press(kinematics, **options):
    """The rows of the steps, each converged, and the forces of the upper plate."""
    result = fem_snh.run("seal", cells=6, kinematics=kinematics, progress=False, **options)
    assert result.converged, result.status
    return result.steps, [-row["obstacles"]["upper"]["force"][1] for row in result.steps]


@pytest.mark.one_debian
@pytest.mark.parametrize("kinematics", ["axisymmetric", "plane_strain"])
def test_plates_balance_and_the_force_grows(kinematics):
    rows, upper = press(kinematics)
    lower = [row["obstacles"]["lower"]["force"][1] for row in rows]
    assert len(rows) == 6
    assert lower == pytest.approx(upper, rel=1e-6)
    growth = [b - a for a, b in zip([0, *upper], upper, strict=False)]
    assert growth == sorted(growth) and growth[0] > 0  # it stiffens
    assert min(row["min_J"] for row in rows) > 0.9


@pytest.mark.one_debian
def test_half_of_the_height_converges():
    """Press it by 50 %, nearly incompressible, from default settings."""
    _, forces = press("axisymmetric", squeeze=0.5, nu=0.4999, steps=10)
    assert forces == sorted(forces)
