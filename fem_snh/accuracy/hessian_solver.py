"""Linear solves with the Hessian at a solution, for dual problems."""

from __future__ import annotations

from collections.abc import Sequence
from math import nan

from petsc4py import PETSc

from fem_snh._petsc import set_operators
from fem_snh.problem.problem import Problem
from fem_snh.solver.forcing import relative_tolerance
from fem_snh.solver.saddle_point import outer_operator


class HessianSolver:
    """Solves H z = g with the Hessian of a problem, by default at its present state. Collective.

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
            self._assemble(first)

    def __call__(self, rhs: PETSc.Vec) -> PETSc.Vec:
        """Return z; NaN if no solve converges."""
        z = rhs.duplicate()
        while True:
            z.set(0.0)
            with relative_tolerance(self._ksp, self._tolerance):
                self._ksp.solve(rhs, z)
            self.iterations += self._ksp.getIterationNumber()
            if self._ksp.getConvergedReason() > 0:
                return z
            if not self._filters:
                z.set(nan)
                return z
            self._assemble(self._filters.pop(0))

    def _assemble(self, filter: str) -> None:
        problem, ksp = self._problem, self._ksp
        problem.jacobian(problem.x, filter)
        if problem.saddle_point:
            problem.saddle_point.update_schur_approximation(problem.A)
        set_operators(ksp, outer_operator(ksp, problem.operator, problem.A), problem.A)
