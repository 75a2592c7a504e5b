"""Semi-implicit steps: the residual of their linear system decides, whatever a solver reports."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import constrained, dense
from running import solve
from time_scenes import SWING, in_time

from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.runs.setup import set_up
from fem_snh.scenes import MaterialChoice, Scene
from fem_snh.solver.predictor import linearised_residual
from fem_snh.steps.dynamics.dynamics import Dynamics

#: -ksp_rtol of the built-in solvers.
RTOL = 1e-3
FALL = {"duration": 0.2, "steps": 4, "integrator": "semi_implicit"}


def exact_steps(scene: Scene) -> np.ndarray:
    """Return the displacement after linearised steps that numpy solves, of this rank's nodes."""
    setup = set_up(MPI.COMM_WORLD, scene)
    p, transient = setup.problem, setup.stepper.motion
    assert isinstance(transient, Dynamics)
    steps, first = setup.stepper.steps, p.x.getOwnershipRange()
    for k in range(1, steps + 1):
        p.history.begin_step(p.split(p.x)[0])
        transient.begin_step(p, k / steps)
        p.set_load(k / steps)
        r = linearised_residual(p)
        p.jacobian(p.x, "exact")
        fixed = np.concatenate(p.comm.allgather(constrained(p)))
        A, f = dense(p.A), np.concatenate(p.comm.allgather(r.array_r))
        A[fixed], A[:, fixed], f[fixed] = 0, 0, 0
        A[fixed, fixed] = 1
        p.x.array[:] -= np.linalg.solve(A, f)[slice(*first)]
        transient.end_step(p)
    return p.x.array_r.copy()


@pytest.mark.mpi
def test_a_bar_of_two_materials() -> None:
    """Steel below a soft half: CG ends with 0.6 of the residual left; numpy has the answer."""
    values = {"name": "stable_neo_hookean", "nu": 0.3, "density": 1000.0}
    materials = [MaterialChoice(group="second", E=2e11, **values), MaterialChoice(E=1e5, **values)]
    bar = {"mesh": {"source": "bar"}, "cells": 4, "material": materials, "petsc": {}}
    scene = in_time(FALL, **SWING, **bar)
    found = solve(scene)
    steps = found.record["steps"]
    assert found.converged and [row["time_step"] for row in steps] == [pytest.approx(0.05)] * 4
    assert all(row["linear_residual"] <= RTOL for row in steps)
    expected = exact_steps(scene)
    error, size = (
        found.problem.comm.allreduce(float(np.abs(v).max()), op=MPI.MAX)
        for v in (found.problem.x.array_r - expected, expected)
    )
    assert size == pytest.approx(0.2305, rel=1e-3)
    assert error < 1e-2 * size
    replaced = [row["reason"] for row in steps if row["reason"] != "CONVERGED_ITS"]
    start, end = "CONVERGED_ITS: sparse factors, as iterations left ", " of the residual"
    assert replaced or found.problem.comm.size > 1  # in another order rounding leaves less
    assert all(text.startswith(start) and text.endswith(end) for text in replaced)


@pytest.mark.parametrize(
    "reason", ["CONVERGED_HAPPY_BREAKDOWN", "CONVERGED_ITS", "CONVERGED_RTOL", "DIVERGED_BREAKDOWN"]
)
def test_what_the_linear_solver_reports(reason: str) -> None:
    """A solver that returns a tenth of the solution, whatever it reports, is refined."""

    class Tenth(EisenstatCG):
        def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
            super().solve(ksp, b, x)
            x.scale(0.1)
            ksp.setConvergedReason(getattr(PETSc.KSP.ConvergedReason, reason))

    scene = in_time(FALL, **SWING, petsc={})
    exact = exact_steps(scene)
    setup = set_up(MPI.COMM_WORLD, scene)
    setup.snes.getKSP().setPythonContext(Tenth(setup.problem.coordinates))
    rows = list(setup.stepper)
    assert all(row["converged"] and row["linear_residual"] <= RTOL for row in rows)
    assert setup.problem.x.array_r == pytest.approx(exact, abs=5e-3 * np.abs(exact).max())


@pytest.mark.mpi
def test_a_stiff_body_that_turns_about_a_spring_follows_its_loads() -> None:
    """Its elastic forces at the start of a step are 100 times the weight, which turns it."""
    scene = {
        "name": "pendulum", "cells": 2, "element": "Q1",
        "mesh": {"source": "bar", "parameters": {"length": 4, "interface": 2}},
        "material": {"name": "stable_neo_hookean", "E": 2.1e11, "nu": 0.3, "density": 7800},
        "rigid": [{"group": "right", "mass": 1e4, "spring": {"stiffness": 1e8}}],
        "gravity": {"vector": [0, 0, -9.81]},
        "time": {"duration": 1.2, "steps": 12, "integrator": "semi_implicit"},
        "probe": [{"name": "tip", "point": [4, 1, 1]}],
    }  # fmt: skip
    found, exact = (
        [row["probes"]["tip"][2] for row in solve(Scene.model_validate(scene | keys)).steps]
        for keys in ({}, {"petsc": {"snes_linear_solver": "direct"}})
    )
    assert found == pytest.approx(exact, rel=2e-3)
