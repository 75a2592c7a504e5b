"""Frequencies as goals: exact modes of a box, bodies that are loaded, free or partly rigid."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve

from fem_snh.scenes import Accuracy, Geometry, Hold, MaterialChoice, Modes, Scene, load

mpi = pytest.mark.mpi

#: mu = rho = 1 and nu = 0.3; the speed of pressure waves is sqrt(3.5).
MATERIAL = MaterialChoice(name="stable_neo_hookean", E=2.6, nu=0.3, density=1.0)
#: Frequencies of a unit cube between rollers [Hz], with the wave numbers pi (1, 1, 0) and its
#: permutations, (1, 1, 1) twice, and (1, 0, 0) of pressure waves.
EXACT = np.concatenate([np.full(3, 2**0.5), np.full(2, 3**0.5), np.full(3, 3.5**0.5)]) / 2
FACES = {"left": "x", "right": "x", "front": "y", "back": "y", "bottom": "z", "top": "z"}


def box(element, cells, **keys):
    chosen = {
        "mesh": Geometry(source="cube"),
        "material": MATERIAL,
        "hold": [Hold(group=group, components=[axis]) for group, axis in FACES.items()],
        "modes": Modes(count=len(EXACT)),
    } | keys
    return Scene(name="box", cells=cells, element=element, error=True, **chosen)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element, cells", [("Q1", 4), ("P1", 4), ("Q1P0", 4), ("Q2", 3)])
def test_errors_of_the_modes_of_a_box(comm, element, cells):
    """Two frequencies are triple, one is double: a basis of their modes is arbitrary."""
    goals = [f"frequency.{i}" for i in range(1, len(EXACT) + 1)]
    found = solve(box(element, cells, accuracy=Accuracy(goals=goals)), comm).goals
    for name, exact in zip(goals, EXACT, strict=True):
        error = exact - found[name]["value"]
        assert error < -1e-4 * exact
        assert 0.7 <= found[name]["error"] / error <= 1.4
        assert abs(found[name]["corrected"] - exact) < abs(error) / 3


def errors(comm, coarse, fine, numbers):
    """Return the estimates over the errors, of frequencies of a scene and a much finer one."""
    goals = [f"frequency.{i}" for i in numbers]
    update = {"error": True, "accuracy": Accuracy(goals=goals)}
    found = solve(coarse.model_copy(update=update), comm).goals
    exact = solve(fine.model_copy(update={"error": False}), comm).record["modes"]["frequencies"]
    true = [exact[i - 1] - found[name]["value"] for name, i in zip(goals, numbers, strict=True)]
    return np.array([found[name]["error"] for name in goals]) / true


@pytest.mark.one_debian
@mpi
def test_errors_about_a_loaded_state(comm):
    """Half of the error of the first frequency is that of the state, which the tip's load bends."""
    scene = load("cook", cells=6, element="Q1P0", nu=0.49, modes=Modes(count=3, density=1000))
    fine = load("cook", cells=24, element="Q2", nu=0.49, modes=Modes(count=3, density=1000))
    assert ((0.7 < (ratio := errors(comm, scene, fine, [1, 2, 3]))) & (ratio < 1.4)).all(), ratio


@mpi
def test_a_free_body_has_six_frequencies_of_zero(comm):
    free = box("Q1", 3, hold=[], modes=Modes(count=8))
    found = solve(free, comm)
    names = [f"frequency.{i}" for i in range(1, 9)]
    assert all(found.goals[name]["value"] == 0 for name in names[:6])
    assert all(abs(found.goals[name]["error"]) < 1e-6 for name in names[:6])
    fine = box("Q2", 6, hold=[], modes=Modes(count=8))
    ratio = errors(comm, free, fine, [7, 8])
    assert ((ratio > 0.7) & (ratio < 1.4)).all(), ratio


@pytest.mark.one_debian
def test_levels_reach_an_accuracy_of_frequencies(comm):
    goals = [f"frequency.{i}" for i in (1, 4, 6)]
    wanted = Accuracy(goals=goals, within=0.01)
    result = solve(box("P1", 3, accuracy=wanted), comm)
    assert result.record["accuracy"]["reached"]
    last = result.record["accuracy"]["levels"][-1]["goals"]
    for name, exact in zip(goals, EXACT[[0, 3, 5]], strict=True):
        assert last[name]["best"] == pytest.approx(exact, rel=0.01)
