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

from fem_snh.problem.problem import Problem

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
                z = problem.x.duplicate()
                z.set(0.0)
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
        g = self.problem.x.duplicate()
        g.set(0.0)
        size = self.problem.owned_displacements
        g.array[:size] = derivative.array_r[:size]
        return self.dual_of_all(g)

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
    h, product, other = _DIFFERENCE * problem.length, e.duplicate(), e.duplicate()
    problem.gradient(problem.x + h * e, product)
    problem.gradient(problem.x - h * e, other)
    product.axpy(-1.0, other)
    product.scale(1 / (2 * h))
    return product
