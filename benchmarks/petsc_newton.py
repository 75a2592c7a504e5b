"""Trust regions on large loads in one step: ours beside PETSc's SNESNEWTONTR and TAO's BNTR.

All start from the same state, minimise the same energy with the same residual, and end at the same
norm of the residual. PETSc's methods get the exact Hessian, which is indefinite far from a
solution. Their linear solvers are their defaults (GMRES with ILU; Steihaug's CG), or Steihaug's CG
with incomplete Cholesky factors of each rank's block.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from time import perf_counter
from typing import Any

from petsc4py import PETSc

from benchmarks import Row, split_list
from benchmarks.negative_curvature import CASES, create
from fem_snh import solver
from fem_snh._petsc import default_options
from fem_snh.errors import choose
from fem_snh.problem.problem import Problem

#: The prefix of PETSc's solvers, apart from that of ours.
_PREFIX = "petsc_newton_"
#: Incomplete Cholesky factors of each rank's block.
_ICC = {"pc_type": "bjacobi", "sub_pc_type": "icc"}
#: The reason in a row whose solve ended in an error.
_ERROR = "PETSc error"


def rows(
    cases: str = "half turn,stretch",
    nus: str = "0.3,0.49",
    cells: str = "6",
    methods: str = "ours,newtontr,newtontr+stcg,bntr,bntr+icc",
    tolerance: float = 1e-7,
    most: int = 500,
) -> Iterator[Row]:
    """Yield one row per case, Poisson's ratio, mesh and method.

    cases : of `benchmarks.negative_curvature`: the twist by half a turn, the stretch to 3.4.
    methods : "ours", a line search ("linesearch"), and PETSc's ones; see `METHODS`.
    tolerance : of the residual, relative to E V^(2/3).
    most : nonlinear iterations.
    """
    for case in split_list(cases):
        for nu in split_list(nus):
            for n in split_list(cells):
                problem = create(choose("case", case, CASES), float(nu), int(n))
                for method in split_list(methods):
                    solve = METHODS[choose("method", method, METHODS)]
                    row: Row = {"case": case, "nu": float(nu), "cells": int(n)}
                    row |= {"ranks": problem.comm.size, "method": method}
                    yield row | _measured(problem, solve, tolerance * problem.force_scale, most)


def _measured(
    problem: Problem, solve: Callable[[Problem, float, int], Row], atol: float, most: int
) -> Row:
    """Start from rest with the new boundary values; return counts, energy, residual, seconds."""
    x, f = problem.x, problem.x.duplicate()
    x.set(0.0)
    problem.set_load(1.0)
    problem.prescribe(x)
    start = perf_counter()
    try:
        row = solve(problem, atol, most)
    except PETSc.Error as error:
        row = {
            "newton": None,
            "linear": None,
            "converged": False,
            "reason": f"{_ERROR} {error.ierr}",
        }
    row["seconds"] = round(perf_counter() - start, 2)
    problem.residual(x, f)
    return row | {"energy": float(f"{problem.energy(x):.6g}"), "residual": float(f"{f.norm():.2g}")}


def _ours(globalization: str) -> Callable[[Problem, float, int], Row]:
    """Return our solver with this globalization."""

    def solve(problem: Problem, atol: float, most: int) -> Row:
        settings = {"snes_scaled_tol": atol / problem.force_scale, "snes_max_it": most}
        with default_options(solver.PREFIX, settings):
            snes = solver.create(problem, globalization=globalization)
        snes.solve(None, problem.x)
        history = snes.getPythonContext().history
        return {
            "newton": len(history),
            "linear": sum(i.linear for i in history),
            "lbfgs": sum(i.lbfgs for i in history),
            "converged": snes.getConvergedReason() > 0,
            "reason": solver.failure_reason(snes),
        }

    return solve


def _newtontr(settings: dict[str, Any]) -> Callable[[Problem, float, int], Row]:
    """Return PETSc's SNESNEWTONTR with these options."""

    def solve(problem: Problem, atol: float, most: int) -> Row:
        snes = PETSc.SNES().create(problem.comm)
        snes.setOptionsPrefix(_PREFIX)
        snes.setType(PETSc.SNES.Type.NEWTONTR)
        snes.setObjective(lambda snes, x: problem.energy(x))
        snes.setFunction(lambda snes, x, f: problem.residual(x, f), problem.x.duplicate())
        snes.setJacobian(lambda snes, x, A, P: problem.jacobian(x, "exact"), problem.A)
        snes.setTolerances(rtol=0.0, atol=atol, stol=0.0, max_it=most)
        snes.setMaxFunctionEvaluations(2**31 - 1)
        with default_options(_PREFIX, settings):
            snes.setFromOptions()
            snes.solve(None, problem.x)
        return {
            "newton": snes.getIterationNumber(),
            "linear": snes.getLinearSolveIterations(),
            "converged": snes.getConvergedReason() > 0,
            "reason": solver.converged_reason(snes),
        }

    return solve


def _bntr(settings: dict[str, Any]) -> Callable[[Problem, float, int], Row]:
    """Return TAO's Newton method with a trust region, with these options."""

    def solve(problem: Problem, atol: float, most: int) -> Row:
        tao, linear = PETSc.TAO().create(problem.comm), [0]

        def hessian(tao: PETSc.TAO, x: PETSc.Vec, H: PETSc.Mat, P: PETSc.Mat) -> None:
            linear[0] += tao.getKSP().getIterationNumber()  # of the solve before
            problem.jacobian(x, "exact")

        tao.setOptionsPrefix(_PREFIX)
        tao.setType(PETSc.TAO.Type.BNTR)
        tao.setObjective(lambda tao, x: problem.energy(x))
        tao.setGradient(lambda tao, x, f: problem.residual(x, f), problem.x.duplicate())
        tao.setHessian(hessian, problem.A)
        tao.setTolerances(gatol=atol, grtol=0.0, gttol=0.0)
        tao.setMaximumIterations(most)
        tao.setMaximumFunctionEvaluations(2**31 - 1)
        with default_options(_PREFIX, settings):
            tao.setFromOptions()
            tao.solve(problem.x)
        reasons = {v: k for k, v in vars(PETSc.TAO.Reason).items() if isinstance(v, int)}
        code = tao.getConvergedReason()
        return {
            "newton": tao.getIterationNumber(),
            "linear": linear[0] + tao.getKSP().getIterationNumber(),
            "converged": code > 0,
            "reason": reasons.get(code, str(code)),
        }

    return solve


#: The methods by name: "+stcg" and "+icc" have incomplete Cholesky factors.
METHODS: dict[str, Callable[[Problem, float, int], Row]] = {
    "ours": _ours("trust_region"),
    "linesearch": _ours("linesearch"),
    "newtontr": _newtontr({}),
    "newtontr+stcg": _newtontr({"ksp_type": "stcg", **_ICC}),
    "bntr": _bntr({}),
    "bntr+icc": _bntr({"tao_bnk_pc_type": "bjacobi", "tao_bnk_sub_pc_type": "icc"}),
}
