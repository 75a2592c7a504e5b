"""Bodies in motion for the tests of dynamics: problems with `Dynamics`, and a loop over steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
from bodies import create_problem, cube
from solver_problems import options

from fem_snh import solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Filling
from fem_snh.kernels.material import material
from fem_snh.problem.problem import Problem
from fem_snh.steps.dynamics.dynamics import Dynamics
from fem_snh.terms.loads import Gravity


def moving(
    integrator: str,
    element: str = "Q1",
    cells: int = 1,
    *,
    fillings: Sequence[Filling] | None = None,
    gravity: Sequence[float] | None = None,
    amplitude: Callable[[float], float] = lambda load: 1.0,
    body: Any = None,
    hold: Sequence[Any] = (),
    move: Sequence[Any] = (),
    **options: Any,
) -> tuple[Problem, Dynamics]:
    """Return a problem with inertia, of a body of density 2 and E = 1 unless fillings are given."""
    if body is None:
        body = cube(MPI.COMM_WORLD, ELEMENTS[element].cell, cells, 0.03 if cells > 1 else 0.0)
    if fillings is None:
        fillings = [Filling(material("stable_neo_hookean", E=1.0, nu=0.45), None, 2.0)]

    def motion(*body: Any) -> Dynamics:
        return Dynamics(*body, integrator, **options)

    features = [Gravity(gravity, amplitude)] if gravity else []
    keys = {"hold": hold, "move": move, "motion": motion, "features": features}
    p = create_problem(body, ELEMENTS[element], fillings, **keys)
    assert isinstance(p.motion, Dynamics)
    return p, p.motion


def advance(p: Problem, d: Dynamics, loads: Sequence[float]) -> Iterator[float]:
    """Step to each of these loads; yield it after the step was accepted. Collective.

    ``semi_implicit`` makes one linearised step, all others solve the nonlinear problem.
    """
    tight = {"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-11}
    linear = d.integrator.name == "semi_implicit"
    with options(**tight):
        snes = solver.create(p, globalization="linesearch")
        for load in loads:
            d.begin_step(p, load)
            p.set_load(load)
            if linear:
                assert solver.solve_linearised(p, snes).converged
            else:
                p.prescribe(p.x)
                snes.solve(None, p.x)
                assert snes.getConvergedReason() > 0
            d.end_step(p)
            yield load


def run(p: Problem, d: Dynamics, steps: int) -> None:
    """Take equal steps to load 1. Collective."""
    for _ in advance(p, d, equal_steps(steps)):
        pass


def equal_steps(steps: int) -> list[float]:
    return [k / steps for k in range(1, steps + 1)]


def displacement(p: Problem) -> np.ndarray:
    """Return the displacement of this rank's own nodes, (n, 3)."""
    return p.x.array_r[: p.coordinates.size].reshape(-1, 3)


def spin(rate: float) -> Callable[[Any], np.ndarray]:
    """Return the velocity of a rotation about the vertical axis of the unit cube [rad/s]."""
    return lambda X: np.cross([0.0, 0.0, rate], X - 0.5)
