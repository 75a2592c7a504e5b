"""One nonlinear iteration of Newton's method: with a line search, or without any.

`fem_snh.solver.newton` calls ``step`` once an iteration. The other globalization is in
`fem_snh.solver.trust_region`.
"""

from __future__ import annotations

from math import isfinite
from typing import Protocol

from petsc4py import PETSc

from fem_snh.errors import Failed
from fem_snh.linalg.symmetric_factors import SymmetricFactors
from fem_snh.solver.line_search import LineSearch
from fem_snh.solver.quasi_newton import QuasiNewton
from fem_snh.solver.search_direction import SearchDirection
from fem_snh.solver.step import State, Step

_Reason = PETSc.SNES.ConvergedReason

#: Iterations of Newton's method without a globalization: near a solution it needs 4 to 6.
_MAX_FULL_STEPS = 15


class Globalization(Protocol):
    """A strategy that takes one step: `LineSearchNewton` or `trust_region.TrustRegion`."""

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Take one step from ``start`` to ``trial``; ``d`` becomes the direction. Collective."""


class LineSearchNewton:
    """The strategy of a search direction, a line search along it, then L-BFGS iterations.

    Parameters
    ----------
    direction : SearchDirection
    line_search : LineSearch
    quasi_newton : QuasiNewton, optional
    """

    def __init__(
        self,
        direction: SearchDirection,
        line_search: LineSearch,
        quasi_newton: QuasiNewton | None = None,
    ) -> None:
        self.direction, self.line_search = direction, line_search
        self.quasi_newton = quasi_newton

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Take one step from ``start`` to ``trial``; ``d`` becomes the direction. Collective."""
        norm, step = start.residual.norm(), self._search(start, d, trial)
        if not self.direction.accepts(norm, step):
            linear, step = step.linear, self._search(start, d, trial)
            step.linear += linear
        if step.end is not None and self.quasi_newton is not None:
            self.quasi_newton.continue_from(step, norm)
        return step

    def _search(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Return the step of the line search along the direction at ``start``."""
        direction = self.direction.compute(start, d)
        step = Step(diverged=_Reason.DIVERGED_LINEAR_SOLVE)
        if direction.slope is not None:
            step = self.line_search.search(start, d, direction.slope, trial)
            step.diverged = 0 if step.end else _Reason.DIVERGED_LINE_SEARCH
        step.filter, step.filtered_points = direction.filter, direction.filtered_points
        step.linear, step.negative = direction.linear, direction.negative
        return step


class FullNewton:
    """The strategy of full steps with the exact Hessian, which converge to any equilibrium.

    Minimisation leaves unstable equilibria. Full steps stay on the path of equilibria that they
    start next to.

    Parameters
    ----------
    direction : SearchDirection
        Assembles the Hessian.
    factors : SymmetricFactors
        The factors of its matrix.
    """

    def __init__(self, direction: SearchDirection, factors: SymmetricFactors) -> None:
        self._direction, self._factors, self._count = direction, factors, 0

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Take one step from ``start`` to ``trial``; ``d`` becomes the direction. Collective."""
        step, search = Step(filter="exact"), self._direction.line_search
        step.filtered_points = self._direction.assemble(start.x, "exact")
        self._count += 1
        try:
            self._factors.factorise()
        except Failed:
            step.diverged = _Reason.DIVERGED_LINEAR_SOLVE
            return step
        self._factors.solve(start.residual, d)
        d.scale(-1.0)
        step.length, step.diverged = search.largest_step(start.x, d), _Reason.DIVERGED_LINE_SEARCH
        energy = search.evaluate_energy(start.x, d, step.length, trial)
        if isfinite(energy) and self._count <= _MAX_FULL_STEPS:
            search.evaluate_residual(trial)
            step.end, step.diverged = trial, 0
        return step
