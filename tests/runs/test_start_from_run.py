"""Runs and programs that start from the state of another run."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import unit_cube, vector_space
from interrupted_runs import ALL, ALONE, cut, record, solve

import fem_snh
from fem_snh.errors import BadInput, ResultNote
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Probe, Reaction, Scene, Start

mpi = pytest.mark.mpi
TIGHT = {"snes_scaled_tol": 1e-11, "ksp_rtol": 1e-9, "snes_forcing_max": 0}


def bar(stretch: float | None, **keys: Any) -> Scene:
    """A unit cube between rollers, pulled to a stretch, or released: its strain is uniform."""
    rollers = (("left", "x"), ("front", "y"), ("bottom", "z"))
    given: dict[str, Any] = {
        "name": "bar", "mesh": Geometry(source="cube"), "cells": 2, "element": "Q1", "steps": 2,
        "material": MaterialChoice(name="stable_neo_hookean", E=3.0, nu=0.4),
        "hold": [Hold(group=group, components=(axis,)) for group, axis in rollers],
        "reactions": [Reaction(group="right")], "petsc": TIGHT,
        "probe": [Probe(name="corner", point=(1, 1, 1))],
    }  # fmt: skip
    if stretch is not None:
        given["move"] = [Move(group="right", components=("x",), translate=(stretch - 1, 0, 0))]
    return Scene(**given | keys)


def lateral(stretch: float) -> tuple[float, float]:
    """Return the lateral displacement of the corner and the force: Smith et al. 2018, eq. 13."""
    mu, lam = fem_snh.material("stable_neo_hookean", E=3.0, nu=0.4).numbers.values
    J = 1 + mu / lam * (1 - 1 / stretch)
    return np.sqrt(J / stretch) - 1, mu * (stretch - J / stretch**2)


@pytest.fixture
def pulled(folder: Path) -> Path:
    """The folder of a bar that was pulled to 1.2 and 1.4."""
    solve(bar(1.4), out=folder / "pulled")
    return folder / "pulled"


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize(("mesh", "step"), [("Q1 2", -1), ("Q1 2", 1), ("P2 3", -1), ("Q2Q1 1", 2)])
def test_the_path_goes_from_the_state_to_the_new_conditions(
    pulled: Path, mesh: str, step: int
) -> None:
    """On the same mesh and on others; force and lateral displacement are exact at every load."""
    element, cells = mesh.split()
    start = Start(run=pulled, step=step)
    result = solve(bar(2.0, element=element, cells=int(cells), start=start, steps=4))
    first = 1.4 if step != 1 else 1.2
    assert result.converged and len(result.steps) == 4
    for row in result.steps:
        stretch = first + row["load"] * (2.0 - first)
        across, force = lateral(stretch)
        assert row["probes"]["corner"] == pytest.approx([stretch - 1, across, across], rel=1e-6)
        assert row["reactions"]["right"][0] == pytest.approx(force, rel=1e-6)


@mpi
def test_unload_then_press(pulled: Path, folder: Path) -> None:
    """A released bar is at rest; from there it is pressed, by another material and table."""
    released = solve(bar(None, start=Start(run=pulled)), out=folder / "released")
    assert released.converged
    assert released.steps[-1]["energy"] == pytest.approx(0, abs=1e-9)
    assert np.abs(released.steps[-1]["probes"]["corner"]).max() < 1e-6
    press = bar(0.8, start=Start(run=folder / "released"), hessian="clamp")
    (_, last) = solve(press).steps
    across, force = lateral(0.8)
    assert last["probes"]["corner"] == pytest.approx([-0.2, across, across], rel=1e-5)
    assert last["reactions"]["right"][0] == pytest.approx(force, rel=1e-5)


@mpi
@pytest.mark.parametrize("ranks", [ALL, ALONE])
def test_it_is_resumed_without_the_other_run(pulled: Path, folder: Path, ranks: Any) -> None:
    """On another number of ranks, with the same rows; the start is in the checkpoint."""
    scene = bar(2.0, start=Start(run=pulled), steps=4)
    whole = solve(scene, out=folder / "whole")
    with cut(2):
        solve(scene, out=folder / "cut")
    ALL.barrier()
    if ALL.rank == 0:
        shutil.rmtree(pulled)
    ALL.barrier()
    solve(scene, ranks, out=folder / "cut", resume=True)
    rows = record(folder / "cut")["steps"]
    assert [row["load"] for row in rows] == [0.25, 0.5, 0.75, 1]
    for row, other in zip(rows, whole.steps, strict=True):
        assert row["energy"] == pytest.approx(other["energy"], rel=1e-9)
        assert row["probes"]["corner"] == pytest.approx(other["probes"]["corner"], rel=1e-7)


@mpi
def test_a_program_starts_from_a_run(comm: Any, pulled: Path) -> None:
    """Its path of conditions is that of a scene."""
    domain = unit_cube(comm, 3, "tetrahedron")
    u = fem.Function(vector_space(domain, 2))
    fem_snh.interpolate_run(u, pulled, 1)
    across, _ = lateral(1.2)
    x = u.function_space.tabulate_dof_coordinates()
    assert np.abs(u.x.array.reshape(-1, 3) - x * [0.2, across, across]).max() < 1e-7
    material = fem_snh.material("stable_neo_hookean", E=3.0, nu=0.4)
    V = u.function_space
    clamped = fem.Function(V)
    left = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0))
    right = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 1))
    clamped.x.array[:] = u.x.array  # the sides stay as they are, the far one comes back half-way
    clamped.x.array[3 * right] = 0.1
    problem = fem_snh.NonlinearProblem(
        u, {material: ufl.dx}, bcs=[fem.dirichletbc(clamped, np.append(left, right))]
    )
    for step in problem.steps(2):
        far = u.x.array[3 * right]
        assert far == pytest.approx(0.2 - 0.1 * step["load"], abs=1e-7)


@mpi
def test_nodes_outside_of_a_coarser_mesh(folder: Path) -> None:
    """The surface of a finer cylinder is outside; its nodes move with the closest points."""

    def stretched(cells: int, **keys: Any) -> Scene:
        mesh = Geometry(source="cylinder", parameters={"radius": 0.5, "length": 1.0})
        return bar(
            None, mesh=mesh, cells=cells, steps=1, hold=[Hold(group="left")], probe=[],
            move=[Move(group="right", translate=(0.3, 0, 0))], **keys,
        )  # fmt: skip

    solve(stretched(4), out=folder / "coarse")
    fine = solve(stretched(6, start=Start(run=folder / "coarse")), out=folder / "fine")
    (note,) = (note for note in fine.record["notes"] if note["kind"] == "start")
    assert "nodes are outside of its mesh, by at most 0.0" in note["text"]
    direct = solve(stretched(6))
    assert fine.steps[-1]["energy"] == pytest.approx(direct.steps[-1]["energy"], rel=1e-7)
    with pytest.warns(ResultNote, match="outside of its mesh"):
        u = fine.u.copy()
        fem_snh.interpolate_run(u, folder / "coarse")
        if ALL.rank:
            import warnings

            warnings.warn("outside of its mesh", ResultNote, stacklevel=1)


@mpi
def test_mistakes(pulled: Path, folder: Path) -> None:
    def refused(match: str, **start: Any) -> None:
        with pytest.raises(BadInput, match=match):
            solve(bar(1.5, start=Start(**start)))

    refused(r"start\.step = 3: expected a number from -3 to 2: .* has 3 states", run=pulled, step=3)
    refused(r"run\.json: cannot be read", run=folder / "none")
    far = Geometry(source="cylinder", parameters={"radius": 0.5, "length": 1.0})
    with pytest.raises(BadInput, match=r"expected a run of the same body: .* is .* outside"):
        solve(bar(1.5, start=Start(run=pulled), mesh=far, cells=3, hold=[Hold(group="left")],
                  probe=[],
                  move=[], reactions=[]))  # fmt: skip
    with pytest.raises(BadInput, match="'run' and 'noise' exclude each other"):
        Start(run=pulled, noise=0.1)
    with pytest.raises(BadInput, match="missing key 'run'"):
        Start(step=2)
