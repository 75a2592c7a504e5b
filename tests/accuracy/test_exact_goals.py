"""Exact values of goals: graded meshes, limits, and what the stored values agree with."""

from __future__ import annotations

import pytest

from benchmarks.accuracy_cases import exact
from benchmarks.asked_cases import value_of
from benchmarks.exact_goals import limit, stretch
from benchmarks.graded_meshes import at, graded, write
from benchmarks.pressed_ball import force_ratio
from fem_snh.errors import BadInput
from fem_snh.scenes import Scene
from fem_snh.scenes.builtin.hertz import MODULUS, RADIUS, RATIO


def test_the_limit_of_a_power():
    cells = [4, 8, 16]
    found = limit(cells, [2 + 3 * n**-1.5 for n in cells])
    assert found["value"] == pytest.approx(2, rel=1e-12)
    assert found["order"] == 1.5
    assert found["uncertainty"] == pytest.approx(3 * 16**-1.5 / 2, rel=1e-9)
    uneven = [4, 8, 12]
    found = limit(uneven, [2 + 3 * n**-2.5 for n in uneven])
    assert found["value"] == pytest.approx(2, rel=1e-12)
    assert found["order"] == 2.5
    # No order: the last value, which is known to its last change.
    assert limit(cells, [1.0, 2.0, 3.0])["value"] == 3.0
    assert limit(cells, [1.0, 2.0, 3.0])["uncertainty"] == pytest.approx(1 / 3)
    with pytest.raises(BadInput, match="three meshes"):
        limit([4, 8], [1.0, 2.0])


@pytest.mark.one_debian
def test_a_coarse_section_agrees_with_the_stored_value(tmp_path):
    """The stored value is extrapolated from meshes that are up to four times as fine."""
    assert stretch(tmp_path, 8) == pytest.approx(exact("stretch")[0], rel=1e-4)


def test_the_force_of_the_ball():
    """The series of a linearly elastic ball; strains are up to 0.03 here."""
    ratio = force_ratio(0.2 / RADIUS, RATIO)
    hertz = 4 / 3 * MODULUS / (1 - RATIO**2) * RADIUS**0.5 * 0.2**1.5
    assert 4 * abs(exact("hertz")[0]) == pytest.approx(ratio * hertz, rel=0.005)


def test_four_meshes_tell_the_uncertainty():
    cells = [4, 8, 16, 32]
    found = limit(cells, [2 + 3 * n**-1.5 + n**-3.0 for n in cells])
    assert abs(found["value"] - 2) < 2 * found["uncertainty"] < 0.1 * 3 * 32**-1.5


@pytest.mark.parametrize(("element", "dim"), [("P1", 2), ("P1", 3), ("Q1", 2), ("Q1", 3)])
def test_a_grid_of_groups(tmp_path, element, dim):
    """Stiff and soft parts of equal strain fill halves: the force is the mean modulus's."""
    path, axes = tmp_path / "grid.msh", [graded((-1, 0, 1), 2, 2.0)] * dim
    sides = {"left": at(0, -1.0), "right": at(0, 1.0)}
    parts = {"stiff": lambda x: x[:, 1] > 0, "soft": lambda x: x[:, 1] < 0}
    write(path, axes, sides, parts=parts, simplices=element == "P1")
    material = {"name": "neo_hookean", "nu": 0.0}
    scene = {
        "name": "parts", "mesh": path, "element": element,
        "kinematics": "plane_strain" if dim == 2 else None,
        "material": [material | {"E": E, "group": g} for g, E in (("stiff", 3.0), ("soft", 1.0))],
        "hold": [{"group": "left", "components": ["x"]},
                 *({"group": g, "components": ["y", "z"]} for g in parts)],
        "move": [{"group": "right", "translate": [1e-5, 0, 0], "components": ["x"]}],
    }  # fmt: skip
    force = value_of(Scene.model_validate(scene), "right.force.x")
    assert force == pytest.approx(2 * 5e-6 * 2 ** (dim - 1), rel=1e-4)
