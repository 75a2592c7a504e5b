"""Policies for negative curvature in Newton's method, on large loads in one step."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi
from statistics import median
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks import Row, policy, split_list
from benchmarks.linear_iterations import ICC
from fem_snh import solver
from fem_snh._petsc import default_options
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Filling
from fem_snh.errors import choose
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.problem.definition import Definition
from fem_snh.problem.problem import Problem
from fem_snh.scenes import Hold, Move, Rotate, Traction
from fem_snh.solver.search_direction import SearchDirection
from fem_snh.solver.step import State, Step

#: A small linear tolerance, as in the scene twist, so that rounding has less influence.
TIGHT = {"snes_forcing_max": 5e-3}
#: Distance of the gain ratio from 1 up to which `Ratio` uses the clamped Hessian.
_RATIO_TOLERANCE = 0.01


class Ratio(SearchDirection):
    """The choice of Chen, Liu, Jacobson, Levin & Zheng 2024 between abs and clamp.

    clamp after a step whose decrease was within 1 % of that of the exact quadratic model; abs
    otherwise, and in the first iteration.
    """

    _model: tuple[float, float, float] | None = None  # energy, slope and curvature
    _length = 0.0

    def compute(self, start: State, d: PETSc.Vec) -> Step:
        self.hessian = "abs"
        if self._model:
            energy, slope, curvature = self._model
            predicted = -self._length * (slope + self._length / 2 * curvature)
            if abs(energy - start.energy - predicted) <= _RATIO_TOLERANCE * abs(predicted):
                self.hessian = "clamp"
        step = super().compute(start, d)
        if step.slope is not None:
            self.assemble(start.x, "exact")
            Ad = d.duplicate()
            self.snes.getJacobian()[0].mult(d, Ad)
            self._model = start.energy, step.slope, Ad.dot(d)
        return step

    def accepts(self, start_norm: float, step: Step) -> bool:
        self._length = step.length
        return True


def _turn(angle: float) -> dict[str, Any]:
    """Return the conditions of a cube whose top is turned by an angle."""
    turn = Rotate(axis=(0, 0, 1), through=(0.5, 0.5, 0.5), angle=angle)
    return {"hold": [Hold(group="bottom")], "move": [Move(group="top", rotate=turn)]}


#: Mesh, its parameters, conditions, and the random displacement of the nodes in cell sizes (0: the
#: option ``noise``) of each case.
CASES: dict[str, tuple[str, dict[str, float], dict[str, Any], float]] = {
    "half turn": ("cube", {}, _turn(pi), 0.0),
    "quarter turn": ("cube", {}, _turn(pi / 2), 0.0),
    "stretch": (
        "cylinder",
        {"radius": 0.5, "length": 1.0},
        {"hold": [Hold(group="left")], "move": [Move(group="right", translate=(2.4, 0, 0))]},
        0.0,
    ),
    "column": (
        "cylinder",
        {"radius": 0.5, "length": 6.0},
        {"hold": [Hold(group="left")], "move": [Move(group="right", translate=(-1.8, 0, 0))]},
        0.0,
    ),
    "cook": (
        "cook",
        {},
        {
            "hold": [Hold(group="left"), Hold(group="faces", components=("z",))],
            "traction": [Traction(group="right", vector=(0, 0.026, 0))],
        },
        0.0,
    ),
    "scramble": ("cube", {}, {"hold": [Hold(group="bottom")]}, 1.0),
}


def rows(
    cases: str = "half turn",
    nus: str = "0.3",
    cells: str = "8,10,12,15",
    hessians: str = "adaptive+trust_region",
    lbfgs: str = "0,20",
    seeds: int = 3,
    noise: float = 1e-10,
    tolerance: float = 1e-7,
    most: int = 200,
    factors: bool = False,
) -> Iterator[Row]:
    """Yield one row per case, nu, mesh, policy and limit on the L-BFGS iterations.

    Parameters
    ----------
    hessians : str
        Comma list of H (with line search), H+trust_region, or "ratio": see `Ratio`.
    lbfgs : str
        Limits on the L-BFGS iterations after each Newton iteration.
    seeds : int
        Random initial displacements of size ``noise`` (a length; the default is that of rounding
        errors).
    tolerance : float
        Tolerance of the residual, in E V^(2/3).
    most : int
        Limit on the Newton iterations.
    factors : bool
        Precondition with incomplete Cholesky factors outside the trust region: L-BFGS iterations
        need a good preconditioner.

    Yields
    ------
    dict
        Lists have one value per seed; ``newton`` is None without convergence.
    """
    for case in split_list(cases):
        for nu in split_list(nus):
            for n in split_list(cells):
                p = create(case, float(nu), int(n))
                for hessian in split_list(hessians):
                    for extra in split_list(lbfgs):
                        row: Row = {"case": case, "nu": float(nu), "cells": int(n)}
                        row |= {"ranks": p.comm.size, **policy(hessian), "allowed": int(extra)}
                        settings: dict[str, Any] = TIGHT | (ICC if factors else {})
                        settings |= {"snes_lbfgs_max_it": int(extra), "snes_max_it": most}
                        settings["snes_scaled_tol"] = tolerance
                        runs = [
                            solve(p, case, int(n), hessian, noise, seed, settings)
                            for seed in range(seeds)
                        ]
                        row |= {key: [run[key] for run in runs] for key in runs[0]}
                        row["seconds"] = round(median(row["seconds"]), 2)
                        yield row


def create(case: str, nu: float, cells: int) -> Problem:
    """Return the problem of a case: Q1 hexahedra, E = 1, on all ranks."""
    source, sizes, conditions, _ = CASES[choose("case", case, CASES)]
    body = mesh.generate(MPI.COMM_WORLD, source, "hexahedron", cells=cells, **sizes)
    snh = material("stable_neo_hookean", E=1.0, nu=nu)
    given = [*conditions.get("hold", ()), *conditions.get("move", ())]
    return Definition(body, ELEMENTS["Q1"], [Filling(snh)], given).problem()


def solve(
    p: Problem,
    case: str,
    cells: int,
    hessian: str,
    noise: float,
    seed: int,
    settings: dict[str, Any],
) -> Row:
    """Solve from one random start; return its iterations, energy and seconds."""
    size = CASES[case][3] / cells or noise
    random = np.random.default_rng([seed, p.comm.rank])
    p.x.array[:] = size * random.uniform(-1, 1, p.x.getLocalSize())
    p.set_load(1.0)
    p.prescribe(p.x)
    with default_options(solver.PREFIX, settings):
        snes = solver.create(p, **policy("abs" if hessian == "ratio" else hessian))
        context = snes.getPythonContext()
    if hessian == "ratio":
        context.search_direction = Ratio
    began = perf_counter()
    snes.solve(None, p.x)
    took = perf_counter() - began
    history = context.history
    return {
        "newton": len(history) if snes.getConvergedReason() > 0 else None,
        "lbfgs": sum(i.lbfgs for i in history),
        "linear": sum(i.linear for i in history),
        "energy": round(p.energy(p.x), 6),
        "seconds": took,
    }
