"""One nonlinear iteration of Newton's method: with a line search, or without any.

`fem_snh.solver.newton` calls ``step`` once an iteration. The other globalization is in
`fem_snh.solver.trust_region`.
"""

from __future__ import annotations

from math import inf, isfinite

from petsc4py import PETSc

from fem_snh._petsc import factors_out_of_memory, set_operators
from fem_snh.solver.line_search import LineSearch
from fem_snh.solver.quasi_newton import QuasiNewton
from fem_snh.solver.search_direction import SearchDirection
from fem_snh.solver.step import State, Step

_Reason = PETSc.SNES.ConvergedReason

#: Iterations of Newton's method without a globalization: near a solution it needs 4 to 6.
_MAX_FULL_STEPS = 15
#: Residual over that of the first iteration from which it diverges: a point that comes into contact
#: changes forces by a stiffness, not by orders of magnitude.
_MOST_GROWTH = 1e3


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
    ksp : KSP
        Factorises its matrix, which may not be symmetric.
    """

    def __init__(self, direction: SearchDirection, ksp: PETSc.KSP) -> None:
        self._direction, self._ksp, self._count, self._largest = direction, ksp, 0, 0.0

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Take one step from ``start`` to ``trial``; ``d`` becomes the direction. Collective."""
        step, search, norm = Step(filter="exact"), self._direction.line_search, inf
        step.filtered_points = self._direction.assemble(start.x, "exact")
        self._count += 1
        self._largest = self._largest or _MOST_GROWTH * start.residual.norm()
        A, P = self._direction.snes.getJacobian()[:2]
        set_operators(self._ksp, A, P)
        self._ksp.solve(start.residual, d)
        d.scale(-1.0)
        step.diverged = _Reason.DIVERGED_LINE_SEARCH
        if factors_out_of_memory(self._ksp.getPC()):
            step.diverged = _Reason.DIVERGED_LINEAR_SOLVE
        elif isfinite(d.norm()) and self._count <= _MAX_FULL_STEPS:
            step.length = search.largest_step(start.x, d)
            if isfinite(search.evaluate_energy(start.x, d, step.length, trial)):
                search.evaluate_residual(trial)
                norm = trial.residual.norm()
        if norm <= self._largest:
            step.end, step.diverged = trial, 0
        else:
            self._ksp.reset()  # factors that are not finite would stay so
        return step
