"""An O-ring between two plates with friction: it converges, and the forces are in equilibrium."""

from __future__ import annotations

import pytest

import fem_snh
from fem_snh.errors import BadInput
from fem_snh.scenes.builtin.seal import SECTOR


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
def test_friction_is_balanced_by_the_plane_of_symmetry():
    rows, _ = press("plane_strain")
    for row in rows:
        friction = [plate["force"][0] for plate in row["obstacles"].values()]
        assert max(friction) < 0  # against the sides that bulge
        assert row["reactions"]["middle"][0] == pytest.approx(-sum(friction), rel=1e-5)
        for plate in row["obstacles"].values():
            assert abs(plate["force"][0]) < 0.2 * (1 + 1e-9) * abs(plate["force"][1])


@pytest.mark.one_debian
def test_half_of_the_height_converges():
    """Press it by 50 %, nearly incompressible, from default settings."""
    _, forces = press("axisymmetric", squeeze=0.5, nu=0.4999, steps=10)
    assert forces == sorted(forces)


@pytest.mark.parametrize("kinematics", ["axisymmetric", "plane_strain"])
def test_a_groove_acts_from_where_its_walls_are_touched(kinematics):
    """The plates' own forces before; then it stiffens, as a closed gland does."""
    rows, grooved = press(kinematics, groove=2.3, nu=0.4999)
    _, free = press(kinematics, nu=0.4999)
    assert grooved[:3] == pytest.approx(free[:3], rel=0.01)
    assert grooved[-1] > 1.3 * free[-1]
    for row, upper in zip(rows, grooved, strict=True):
        assert row["obstacles"]["lower"]["force"][1] == pytest.approx(upper, rel=1e-5)
    assert min(row["min_J"] for row in rows) > 0.85


@pytest.mark.one_debian
def test_section_is_the_sector_of_the_ring():
    """15 degrees of it between two planes of symmetry, on cells of the same size."""
    (section,), (solid,) = (
        press(kinematics, squeeze=0.1, steps=1)[1] for kinematics in ("axisymmetric", "3D")
    )
    assert solid * 360 / SECTOR == pytest.approx(section, rel=0.01)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"groove": 1.9}, "groove = 1.9: expected a number of at least 2"),
        ({"groove": 11.0}, "groove = 11.0: expected a number below 10"),
        ({"groove": 2.6, "squeeze": 0.5}, "squeeze = 0.5: expected below 0.396"),
        ({"groove": 3.0, "kinematics": "3D"}, "groove = 3.0: expected no value"),
        ({"kinematics": "plane_stress"}, "kinematics = 'plane_stress': expected one of"),
        ({"squeeze": 1.0}, "squeeze = 1.0: expected less than 1"),
        ({"ring": 1.0}, "ring = 1.0: expected greater than 1"),
    ],
)
def test_mistakes_are_one_line(given, message):
    with pytest.raises(BadInput, match=message):
        fem_snh.run("seal", progress=False, **given)
