r"""Dual problems of goals: H z = g with the Hessian at the solution of the lifted problem.

With the derivative g of a goal by the unknowns, its error is :math:`-z \cdot r` to first order, r
the residual of the run's solution in the lifted problem (Becker & Rannacher 2001).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from math import nan
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import set_operators, vector_like
from fem_snh.problem.problem import Problem
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.saddle_point import outer_operator
from fem_snh.solver.step import relative_tolerance

#: Length of the central difference of residuals relative to the body: about the cube root of the
#: rounding error, where truncation and rounding are balanced.
_DIFFERENCE = 1e-6


class Dual(NamedTuple):
    """The dual solution of a goal: H^-1 g + offset.

    Attributes
    ----------
    derivative : PETSc.Vec or None
        g, the derivative of the goal by all unknowns, reduced to those that are free; None: zero.
    offset : PETSc.Vec or None
        What is known of the solution; NaN where the goal has none. None: zero.
    """

    derivative: PETSc.Vec | None
    offset: PETSc.Vec | None = None


@dataclass(frozen=True)
class Linearisation:
    """The lifted problem, linearised about its solution.

    Attributes
    ----------
    problem : Problem
        The lifted problem at its solution.
    step : PETSc.Vec
        The lifted problem's solution less that of the run.
    solve : callable
        Solves H z = g for several g with the Hessian, which is symmetric. Collective.
    """

    problem: Problem
    step: PETSc.Vec
    solve: Callable[[Sequence[PETSc.Vec]], Sequence[PETSc.Vec]]

    def solutions(self, duals: Sequence[Dual]) -> list[PETSc.Vec]:
        """Return dual solutions; NaN where there is none. They are solved for together."""
        problem = self.problem
        derivatives = [dual.derivative for dual in duals if dual.derivative is not None]
        solved = iter(self.solve(derivatives) if derivatives else ())
        found = []
        for dual in duals:
            if dual.derivative is None:
                z = vector_like(problem.x)
            else:
                z = next(solved)
                if problem.rigid:
                    problem.rigid.expand(problem.x, z.array)
            if dual.offset is not None:
                z.axpy(1.0, dual.offset)
            found.append(z)
        return found

    def dual_of(self, derivative: PETSc.Vec) -> Dual:
        """Return the dual for a derivative by the displacement, a ghosted vector of ``V``."""
        displacements = derivative.array_r[: self.problem.owned_displacements]
        return self.dual_of_all(vector_like(self.problem.x, displacements))

    def dual_of_all(self, g: PETSc.Vec, offset: PETSc.Vec | None = None) -> Dual:
        """Return the dual for a derivative by all displacements and pressures, which is reduced."""
        self.reduce(g)
        return Dual(g, offset)

    def unknown(self) -> Dual:
        """Return the dual of a goal that has none here: NaN."""
        offset = self.problem.x.duplicate()
        offset.set(nan)
        return Dual(None, offset)

    def reduce(self, g: PETSc.Vec) -> None:
        """Reduce a derivative to the unknowns: of rigid parts, and of what is not constrained."""
        if self.problem.rigid:
            self.problem.rigid.reduce_vector(self.problem.x, g)
        self.problem.project(g.array)


def dual_of_reaction(at: Linearisation, e: PETSc.Vec, turning: PETSc.Vec | None) -> Dual:
    """Return the dual of e . dE/du, with a virtual displacement e, which is changed.

    The derivative is H e, beside that of e itself by the displacement, ``turning``. Where e is
    constrained, or of a rigid part, -e is a part of the dual solution; elsewhere e has none.
    """
    problem = at.problem
    free = e.copy()
    problem.project(free.array)
    if problem.rigid:
        free.array[problem.rigid.dofs] = 0.0
    e.axpy(-1.0, free)
    g = _hessian_product(problem, e)
    if turning is not None:
        g.axpy(1.0, turning)
    return at.dual_of_all(g, -e)


def _hessian_product(problem: Problem, e: PETSc.Vec) -> PETSc.Vec:
    """Return H e by a central difference: the assembled matrix has no constrained columns."""
    h = _DIFFERENCE * problem.length
    product = problem.gradient_at(problem.x + h * e)
    product.axpy(-1.0, problem.gradient_at(problem.x - h * e))
    product.scale(1 / (2 * h))
    return product


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
        solutions = []
        for vector in rhs:
            z = vector_like(vector)
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
        problem.saddle_point.update_schur_approximation(problem.P)
    set_operators(ksp, outer_operator(ksp, problem.operator, problem.P), problem.P)
