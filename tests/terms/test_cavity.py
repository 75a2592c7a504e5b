"""Inflation of a thick spherical shell by a prescribed volume, past its limit point."""

from __future__ import annotations

import numpy as np
import pytest
from shells import STRETCH, SYMMETRIC, exact, shell

import fem_snh
from fem_snh.scenes import Cavity, Scene


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("element, nu", [("Q2", 0.49), ("Q2Q1", 0.5), ("P2P1", 0.5)])
def test_pressure_of_the_exact_solution_on_both_sides_of_the_limit_point(element, nu):
    """Within 2 %: one element across the wall, or nu = 0.49 instead of 1/2."""
    result = fem_snh.run(shell(SYMMETRIC, element, nu), progress=False)
    assert result.converged and result.record["terms"] == ["elastic", "cavity"]
    states = [step["cavities"]["inner"] for step in result.steps if step["converged"]]
    pressures = [state["pressure"] for state in states]
    for state, step in zip(states, result.steps, strict=True):
        a = (1 + state["volume"] * 6 / np.pi) ** (1 / 3)
        assert state["pressure"] == pytest.approx(exact(a), rel=0.02)
        assert 1 + step["probes"]["pole"][0] == pytest.approx(a, rel=0.01)
    top = int(np.argmax(pressures))
    assert 0 < top < len(pressures) - 1
    assert a == pytest.approx(STRETCH, rel=0.01)


def test_a_cavity_between_parallel_planes():
    """A cube whose top pushes a fluid between smooth walls: V* is its area times its height."""
    walls = {"left": "x", "right": "x", "front": "y", "back": "y", "bottom": "z"}
    scene = Scene(
        name="box", mesh={"source": "cube"}, cells=1, element="Q1",
        material={"name": "stable_neo_hookean", "E": 3.0, "nu": 0.3},
        hold=[{"group": group, "components": (c,)} for group, c in walls.items()],
        cavity=[Cavity(group="top", volume=0.2, stiffness=1e6)],
        probe=[{"name": "top", "point": (1, 1, 1)}],
    )  # fmt: skip
    step = fem_snh.run(scene, progress=False, petsc={"snes_scaled_tol": 1e-10}).steps[-1]
    F = np.diag([1, 1, 1 + step["probes"]["top"][2]])
    fluid = step["cavities"]["top"]
    assert F[2, 2] == pytest.approx(0.8, abs=1e-5)
    assert fluid["volume"] == pytest.approx(1 - F[2, 2], rel=1e-7)
    stress = fem_snh.material("stable_neo_hookean", E=3.0, nu=0.3).pk1(F)[2, 2]
    assert fluid["pressure"] == pytest.approx(-stress, rel=1e-5)


@pytest.mark.mpi
@pytest.mark.parametrize("stiffness", [1.0, 1e6])
def test_a_large_step_of_a_balloon_takes_few_iterations(stiffness):
    """Half of the cavity's volume more in one step, of a nearly incompressible wall.

    At the step's first guess the pressure k (V* - V) is up to 1e5 times that of the equilibrium.
    """
    scene = shell(SYMMETRIC, "Q1P0", nu=0.49999, steps=1)
    fluid = Cavity(group="inner", volume=4 / 3 * np.pi / 8 / 2, stiffness=stiffness)
    result = fem_snh.run(scene.model_copy(update={"cavity": [fluid]}), progress=False)
    assert len(result.steps) == 1 and result.steps[0]["newton"] <= 6
