"""Linear solves with the Hessian at a solution, for dual problems."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

from petsc4py import PETSc

from fem_snh._petsc import set_operators
from fem_snh.problem.problem import Problem
from fem_snh.solver.block_gmres import solve_columns
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.saddle_point import outer_operator, preconditioner_of_columns
from fem_snh.solver.step import relative_tolerance


class HessianSolver:
    """Solves H z = g with the Hessian of a problem, by default at its present state. Collective.

    Several right-hand sides are solved for together where the linear solver can.

    Parameters
    ----------
    problem : Problem
        The problem at its solution.
    ksp : PETSc.KSP
        Its linear solver.
    tolerance : float
        Relative tolerance of a solve.
    filters : sequence of str
        The Hessians that are tried: the next one where a solve with the last has not converged.
    assembled : bool
        Whether the first of them is in the matrix, with its preconditioner set up.

    Attributes
    ----------
    iterations : int
        Linear iterations so far.
    """

    def __init__(
        self,
        problem: Problem,
        ksp: PETSc.KSP,
        tolerance: float,
        filters: Sequence[str] = ("exact", "clamp"),
        assembled: bool = False,
    ) -> None:
        self._problem, self._ksp, self._tolerance = problem, ksp, tolerance
        self._filters = list(filters)
        self.iterations = 0
        first = self._filters.pop(0)
        if not assembled:
            assemble_hessian(problem, ksp, first)

    def __call__(self, rhs: Sequence[PETSc.Vec]) -> list[PETSc.Vec]:
        """Return z for each right-hand side; NaN if no solve converges."""
        while True:
            with callback_errors(), relative_tolerance(self._ksp, self._tolerance):
                found = self._solutions(rhs)
            if found is not None:
                return found
            if not self._filters:
                found = [vector.duplicate() for vector in rhs]
                for z in found:
                    z.set(nan)
                return found
            assemble_hessian(self._problem, self._ksp, self._filters.pop(0))

    def _solutions(self, rhs: Sequence[PETSc.Vec]) -> list[PETSc.Vec] | None:
        """Return z for each right-hand side, or None if a solve does not converge."""
        if len(rhs) > 1 and (blocks := preconditioner_of_columns(self._ksp)):
            found, iterations = solve_columns(blocks, rhs, self._ksp)
            self.iterations += iterations
            return found
        solutions = []
        for vector in rhs:
            z = vector.duplicate()
            z.set(0.0)
            self._ksp.solve(vector, z)
            self.iterations += self._ksp.getIterationNumber()
            if not self._ksp.getConvergedReason() > 0:
                return None
            solutions.append(z)
        return solutions


def assemble_hessian(problem: Problem, ksp: PETSc.KSP, filter: str) -> None:
    """Assemble a problem's Hessian at its present state for a linear solver. Collective."""
    problem.jacobian(problem.x, filter)
    if problem.saddle_point:
        problem.saddle_point.update_schur_approximation(problem.A)
    set_operators(ksp, outer_operator(ksp, problem.operator, problem.A), problem.A)
