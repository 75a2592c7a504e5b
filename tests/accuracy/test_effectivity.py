"""Estimates over errors, of bodies whose values are known exactly or from much finer meshes."""

from __future__ import annotations

from math import pi, sqrt
from typing import Any, NamedTuple

import pytest
from cook_values import CORNER, EXTRAPOLATED
from running import solve
from shells import SYMMETRIC, exact, shell
from test_term_goals import blocks

from benchmarks import error_estimates
from fem_snh.scenes import MaterialChoice


class Case(NamedTuple):
    """A scene, the values of its goals, bounds of estimate over error, and what is corrected."""

    scene: Any
    keys: dict[str, Any]
    exact: dict[str, float]
    least: float = 0.7
    most: float = 1.4
    #: The corrected value's error, at most, relative to the value's own.
    left: float = 1.0
    #: The error, at least, relative to the value: a small one would be found by chance.
    error: float = 1e-5
    lifted: str | None = None


def cook(element: str, nu: float, **keys: Any) -> dict[str, Any]:
    return {"element": element, "nu": nu, "cells": 8, "kinematics": "layer", "error": True} | keys


#: The bar is that of `python -m benchmarks error_estimates --scenes bar --nus 0.4`.
BAR = {"end.z": 0.036770, "energy": -8.9788e-5}
#: Q2Q1 on 6 cells, whose error is a hundredth of that of Q1P0 on 3.
TWISTED = {"top.force.z": -0.015960, "energy": 0.0250238, "edge.x": -0.304183, "edge.y": 0.167388}
#: Volumes are kept: an incompressible tube whose inner radius 1 becomes 1.5.
TUBE = {"inner.x": 0.5, "outer.x": sqrt(2**2 + 1.5**2 - 1) - 2}
STRESS = {"kinematics": "plane_strain", "steps": 2, "accuracy.goals": "stress"}

CASES = {
    **{
        f"cook {element} {nu}": Case("cook", cook(element, nu), CORNER[nu], left=1 / 2, error=0.06)
        for element in ("Q1", "Q1P0", "P1")
        for nu in (0.3, 0.4999)
    },
    # Of these elements the lifted one leaves what it leaves of the Taylor-Hood element; 0.4 is the
    # least ratio at which an element locks.
    **{
        f"cook {element} {nu}": Case(
            "cook", cook(element, nu, cells=4, kinematics="plane_strain"), EXTRAPOLATED[nu],
            0.8 if nu > 0.4 else 0.7, 1.2 if nu > 0.4 else 1.3, error=error,
        )
        for element in ("P2", "P2P0", "Q2")
        for nu, error in ((0.3, 0.008), (0.4, 0.015), (0.49, 0.03))
    },
    "cook Q2Q1": Case("cook", cook("Q2Q1", 0.4999, cells=4), CORNER[0.4999], most=1.3),
    # In plane stress, against Q2 on 24 cells.
    "sheet": Case(
        "cook", cook("P1", 0.4999, kinematics="plane_stress"),
        {"corner.x": -7.616255, "corner.y": 8.424932}, most=1.1, lifted="P2",
    ),
    # Where no pressure can be an unknown, the lifted element has the mean of the volume ratio;
    # against P2P0 on 32 cells, whose error is below 0.2 %.
    **{
        f"cook {material}": Case(
            "cook", cook(element, 0.49, cells=cells, material=material, kinematics="plane_strain"),
            {"tip.y": 7.001723}, left=1 / 3, error=0.05, lifted=lifted,
        )
        for material, element, cells, lifted in (
            ("c2_neo_hookean", "Q1P0", 8, "Q2P0"), ("neo_hookean", "Q2", 4, "Q3Q2"),
        )
    },
    # 32 and 64 cells of Q2Q1, corrected.
    **{
        f"stress {cells}": Case("cook", {"element": "Q2Q1", "nu": 0.4999, "cells": cells} | STRESS,
                                {"stress": 9.7943})
        for cells in (4, 8, 16)
    },
    "twist": Case("twist", cook("Q1P0", 0.49, cells=3, angle=1.0, kinematics=None), TWISTED),
    **{
        f"bar {element}": Case(
            error_estimates.scene_of("bar", 0.4, element, 2, estimate=True), {}, BAR,
            0.8, 1.1,
        )
        for element in ("P2", "P2P0", "Q2")
    },
    **{
        f"tube {element} {kinematics}": Case(
            "tube", cook(element, nu, cells=4, kinematics=kinematics), TUBE, left=1 / 3
        )
        for element, nu, kinematics in (
            ("P1", 0.4999, "plane_strain"), ("P1", 0.4999, "axisymmetric"),
            ("Q1P0", 0.4999, "axisymmetric"), ("P2P1", 0.5, "axisymmetric"),
            ("Q2Q1", 0.5, "plane_strain"),
        )
    },
    # Against the force on 8 and 12 cells along an edge, with a stiffness of 3e3.
    **{
        f"blocks {element}": Case(
            blocks(element, error=True), {}, {"lower_top/upper_bottom.force.z": force}, 0.6
        )
        for element, force in (("Q1", -0.109505), ("P2", -0.109202))
    },
}  # fmt: skip


@pytest.mark.one_debian
@pytest.mark.parametrize("case", CASES)
def test_effectivity(case: str) -> None:
    scene, keys, values, least, most, left, error, lifted = CASES[case]
    given = {key: value for key, value in keys.items() if value is not None}
    result = solve(scene, **given)
    assert lifted in (None, result.record["estimate"]["element"])
    for name, value in values.items():
        goal = result.estimate.goals[name]
        true = value - goal.value
        assert abs(true) > error * abs(value), name
        assert least < goal.estimate / true < most, name
        assert abs(goal.value + goal.estimate - value) < left * abs(true), name
        assert goal.bound is None or abs(goal.corrected - value) < goal.bound, name
    if case.startswith(("cook P2", "cook Q2", "stress")):  # errors of cells sum to the estimate
        for name, cells in result.estimate.indicators.items():
            assert cells.sum() == pytest.approx(result.estimate.goals[name].estimate, rel=0.3), name


@pytest.mark.one_debian
def test_the_pressure_of_a_fluid() -> None:
    """Against the exact solution, to which nu = 0.4999 adds less than a hundredth of the error."""
    material = MaterialChoice(name="stable_neo_hookean", E=3.0, nu=0.4999)
    update = {"material": material, "error": True, "element": "Q1P0", "cells": 4}
    found = solve(shell(SYMMETRIC).model_copy(update=update))
    goal, volume = found.goals["inner.pressure"], found.steps[-1]["cavities"]["inner"]["volume"]
    error = exact((1 + volume * 6 / pi) ** (1 / 3)) - goal["value"]
    assert 0.01 < abs(error / goal["value"]) < 0.5
    assert 0.7 < goal["error"] / error < 1.4
