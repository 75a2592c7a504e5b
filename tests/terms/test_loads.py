"""Weight, elastic foundations and amplitudes in whole runs, against exact solutions."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.optimize import fsolve

import fem_snh
from fem_snh.scenes import Scene

mpi = pytest.mark.mpi
E, NU, DENSITY = 1.0, 0.45, 2.0
MATERIAL = {"name": "stable_neo_hookean", "E": E, "nu": NU}
#: The stress of stable_neo_hookean is linear in a confined stretch.
NONLINEAR = MATERIAL | {"name": "neo_hookean"}


def run(**tables: Any) -> Any:
    """Return the result of a unit cube with loads."""
    common = {
        "name": "block", "mesh": {"source": "cube"}, "cells": 1, "element": "Q1",
        "material": MATERIAL, "probe": [{"name": "top", "point": (0.5, 0.5, 1)}],
        "petsc": {"ksp_rtol": 1e-8, "snes_scaled_tol": 1e-11},
    }  # fmt: skip
    result = fem_snh.run(Scene(**(common | tables)), progress=False)
    assert result.converged, result.status
    return result


#: No lateral strain; and lateral strain that is free.
CONFINED = [{"group": g, "components": ("x", "y")} for g in ("left", "right", "front", "back")]
FREE = [{"group": "left", "components": ("x",)}, {"group": "front", "components": ("y",)}]


def hanging_tip(g: float) -> float:
    """Displacement of the top of a confined bar that stands on its bottom, by its weight.

    At each Gauss point P33 is the weight above; its stretch is found by bisection.
    """
    material = fem_snh.material(**NONLINEAR)
    Z, weights = np.polynomial.legendre.leggauss(12)
    stress = -DENSITY * g * (1 - Z) / 2
    low, high = np.full(12, 0.2), np.full(12, 3.0)
    for _ in range(55):
        F = np.tile(np.eye(3), (12, 1, 1))
        F[:, 2, 2] = middle = (low + high) / 2
        above = material.pk1(F)[:, 2, 2] > stress
        low, high = np.where(above, low, middle), np.where(above, middle, high)
    return float(weights @ (low - 1) / 2)


@mpi
@pytest.mark.parametrize(("g", "tolerance"), [(1e-3, 1e-7), (0.2, 2e-5), (-0.2, 2e-5)])
def test_bar_under_its_own_weight(g: float, tolerance: float) -> None:
    result = run(
        cells=2, element="Q2", material=NONLINEAR | {"density": DENSITY}, reactions=["bottom"],
        hold=[*CONFINED, {"group": "bottom"}], gravity={"vector": (0, 0, -g)},
    )  # fmt: skip
    step = result.steps[-1]
    exact = hanging_tip(g)
    assert step["probes"]["top"][2] == pytest.approx(exact, rel=tolerance)
    if abs(g) < 0.01:  # Hooke: rho g L^2 / (2 (lambda + 2 mu))
        hooke = -DENSITY * g / 2 * (1 + NU) * (1 - 2 * NU) / (E * (1 - NU))
        assert exact == pytest.approx(hooke, rel=1e-2)
    assert step["reactions"]["bottom"][2] == pytest.approx(DENSITY * g, rel=1e-7)
    assert result.record["terms"] == ["elastic", "gravity"]


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_block_on_a_foundation_sinks_and_is_compressed_uniformly(element: str) -> None:
    force, k = 0.1, 0.5
    result = run(
        element=element, hold=FREE, spring=[{"group": "bottom", "stiffness": (0, 0, k)}],
        traction=[{"group": "top", "vector": (0, 0, -force)}],
    )  # fmt: skip
    axial, lateral = uniaxial(-force)
    top = result.steps[-1]["probes"]["top"]
    assert top[2] == pytest.approx(-force / k + axial - 1, rel=1e-7)
    assert top[0] == pytest.approx((lateral - 1) / 2, rel=1e-6)
    assert result.record["terms"] == ["elastic", "traction", "spring"]


def uniaxial(stress: float) -> tuple[float, float]:
    """Axial and lateral stretch of a bar with free sides, by its material's own PK1."""
    m = fem_snh.material(**MATERIAL)

    def unbalanced(stretches: Any) -> list[float]:
        axial, lateral = stretches
        P = m.pk1(np.diag([lateral, lateral, axial]))
        return [P[2, 2] - stress, P[0, 0]]

    axial, lateral = fsolve(unbalanced, [1.0, 1.0], xtol=1e-13)
    return float(axial), float(lateral)


PRESSED: dict[str, Any] = {
    "traction": [{"group": "top", "vector": (0, 0, 0.2), "table": "rise"}],
    "gravity": {"vector": (0, 0, -0.1), "table": "rise"},
    "pressure": [{"group": "top", "value": 0.2, "table": "rise"}],
    "move": [{"group": "top", "translate": (0, 0, 0.2), "table": "rise"}],
}


@pytest.mark.one_debian
@pytest.mark.parametrize("kind", PRESSED)
def test_unloading_returns_to_rest(kind: str) -> None:
    """By a table that rises and falls; at its peak the state is that of the plain load."""
    tables = {"hold": [{"group": "bottom"}, *CONFINED], kind: PRESSED[kind]}
    tables["material"] = MATERIAL | {"density": DENSITY}
    rise = {"name": "rise", "points": [(0, 0), (0.5, 1), (1, 0)]}
    there_and_back = run(**tables, table=[rise], steps=4)
    plain = run(**tables, table=[rise | {"points": [(0, 0), (1, 1)]}])
    peak = plain.steps[-1]["probes"]["top"][2]
    tips = [step["probes"]["top"][2] for step in there_and_back.steps]
    assert abs(peak) > 0.01
    assert tips[1] == pytest.approx(peak, rel=1e-7)
    assert tips[0] == pytest.approx(tips[2], rel=1e-7)
    assert abs(tips[3]) < 1e-8 * abs(peak)
    assert len(there_and_back.steps) == 4


def test_a_table_of_a_foundation_multiplies_its_stiffness() -> None:
    on = {"name": "on", "points": [(0, 1), (1, 1)]}
    soft = {"name": "soft", "points": [(0, 1), (1, 0.5)]}
    load = [{"group": "top", "vector": (0, 0, -0.05), "table": "on"}]
    spring = [{"group": "bottom", "stiffness": (0, 0, 1.0), "table": "soft"}]
    found = run(hold=FREE, steps=2, table=[on, soft], traction=load, spring=spring)
    first, second = (step["probes"]["top"][2] for step in found.steps)
    assert second - first == pytest.approx(-0.05 / 0.5 + 0.05 / 0.75, rel=1e-6)
