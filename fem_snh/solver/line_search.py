"""A backtracking line search on the energy that survives rounding, infinity and stiff Hessians."""

from __future__ import annotations

from math import inf, isfinite

from petsc4py import PETSc

from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.step import State, Step

#: A change of the energy below these fractions of the energy or of E V is a rounding error. The
#: second is about 20 roundings: an energy density is a difference of numbers of size E.
_ENERGY_ROUNDING, _STIFFNESS_ROUNDING = 1e-12, 4e-15
#: A shorter Newton step shows that its quadratic model did not hold.
SHORT = 0.25
#: A full step is extended if the slope at its end exceeds this fraction of the slope at its start.
_STEEP = 0.3
#: Greatest length of an extended step.
_LONGEST = 3.0
#: A shorter trial step is between these fractions of the previous one (Nocedal & Wright 2006,
#: section 3.5).
_LEAST_CUT, _MOST_CUT = 0.5, 0.1


class LineSearch:
    r"""Backtracking from a full step until the energy decreases sufficiently.

    .. math:: E(x + s d) \le E(x) + c\, s\, f \cdot d, \quad c = 10^{-4}

    (Armijo's condition; Nocedal & Wright 2006, eq. 3.4 and alg. 3.1). The next trial step minimises
    the parabola through both energies and the slope (eq. 3.57); it is half as long where the energy
    is infinite. Where the energy no longer changes in floating point, the condition is put on the
    slopes at both ends instead (Hager & Zhang 2005, eq. 4.1; Longva et al. 2023 for projected
    Newton).

    A filtered Hessian is too stiff, so a full step may end where the energy still decreases
    steeply. One secant step on the slope then extends it, up to three times. It costs an energy and
    a residual, and saves most of the linearly convergent iterations of clamp and abs near a
    solution with negative eigenvalues.

    Without an energy the search uses the residual alone. It accepts a step s with
    :math:`f(x + s d) \cdot d \le (2 c - 1)\, f(x) \cdot d`, the upper bound of Hager & Zhang.

    Where a problem does not admit all of a step, the search starts from the largest part that it
    admits, and extends it no further.

    Parameters
    ----------
    snes : SNES
        The SNES that evaluates energy and residual.
    problem : SolvableProblem
        Which steps it admits, and on which paths. The rounding error of its energy is proportional
        to E V [J].
    armijo, min_step : float
        The constant c, and the shortest step.
    """

    def __init__(
        self,
        snes: PETSc.SNES,
        problem: SolvableProblem,
        armijo: float = 1e-4,
        min_step: float = 1e-10,
    ) -> None:
        self.snes, self.problem, self.has_energy = snes, problem, problem.has_energy
        self.armijo, self.min_step = armijo, min_step
        self._least_change = _STIFFNESS_ROUNDING * problem.force_scale * problem.length
        self._largest_step, self._retraction = problem.largest_step, problem.retraction
        self._prescribe = problem.step_end
        self._stored: State | None = None

    def slope(self, f: PETSc.Vec, d: PETSc.Vec, Ad: PETSc.Vec) -> float | None:
        """Return the energy's slope f.d < 0 along d; None if A shows negative curvature along d."""
        # PETSc's CG can miss an indefinite matrix, so the curvature along d is checked here.
        slope = float(f.dot(d))
        return slope if slope < 0 < Ad.dot(d) else None

    def search(self, start: State, d: PETSc.Vec, slope: float, trial: State) -> Step:
        """Search from ``start`` along ``d`` with ``slope`` = f.d < 0.

        The step found ends in ``trial``, whose vectors are overwritten in any case.
        """
        first, energy = self.largest_step(start.x, d), start.energy
        step = first
        while step >= self.min_step:
            trial_energy = self.evaluate_energy(start.x, d, step, trial)
            change = trial_energy - energy
            if not isfinite(trial_energy):
                step *= _LEAST_CUT
                continue
            rounding = self.is_rounding(change, energy)
            if rounding or change <= self.armijo * step * slope:
                end = self._evaluate_slope(d, trial)
                if not rounding or end <= (2 * self.armijo - 1) * slope:
                    if step == 1.0 and slope < end < _STEEP * slope:
                        return self._extended(start.x, d, slope, end, trial)
                    return Step(trial, step, step == first < 1)
                if not self.has_energy:
                    # The zero of the secant through both slopes.
                    step *= min(_LEAST_CUT, max(_MOST_CUT, slope / (slope - end)))
                    continue
            step = self._shortened(step, change, slope)
        return Step()

    def largest_step(self, x: PETSc.Vec, d: PETSc.Vec) -> float:
        """Return the part of the step ``d`` from ``x`` that the problem admits, in [0, 1]."""
        if self._largest_step is None:
            return 1.0
        if self._retraction and self.follows_paths:
            end = x.duplicate()
            self._retraction(x, d, 1.0, end)
            return self._largest_step(x, end - x)
        return self._largest_step(x, d)

    @property
    def follows_paths(self) -> bool:
        """Whether steps end on curved paths, so that they are no differences of unknowns."""
        return self._retraction is not None and self._retraction.exact

    def admits(self, x: PETSc.Vec, end: PETSc.Vec) -> bool:
        """Return whether the problem admits the straight way from ``x`` to ``end``."""
        return not self._largest_step or self._largest_step(x, end - x) == 1

    def is_rounding(self, change: float, energy: float) -> bool:
        """Return whether a change of the energy is within its rounding error."""
        size = max(abs(energy), abs(energy + change))
        return abs(change) <= max(_ENERGY_ROUNDING * size, self._least_change)

    def evaluate_energy(self, x: PETSc.Vec, d: PETSc.Vec, step: float, trial: State) -> float:
        """Set ``trial``'s unknowns to the end of a step and its energy; return the energy.

        The step is straight, x + step d, of an admissible length, unless there is a curved path
        to an end that is admissible, too. Where steps must follow it, the energy is infinite at an
        end that is not.
        """
        paths, straight = self._retraction, True
        if paths:
            paths(x, d, step, trial.x)
            straight = not self.admits(x, trial.x)
            if straight and paths.exact:
                trial.energy = inf
                return inf
        if straight:
            trial.x.waxpy(step, d, x)
        if self._prescribe:
            self._prescribe(trial.x)
        trial.energy = float(self.snes.computeObjective(trial.x)) if self.has_energy else 0.0
        return trial.energy

    def evaluate_residual(self, trial: State) -> None:
        """Set ``trial``'s residual."""
        self.snes.computeFunction(trial.x, trial.residual)

    @staticmethod
    def _shortened(step: float, change: float, slope: float) -> float:
        """Return the step to the parabola's minimum, within bounds."""
        parabola = change - step * slope
        best = -slope * step**2 / (2 * parabola) if parabola > 0 else step
        return min(_LEAST_CUT * step, max(_MOST_CUT * step, best))

    def _extended(self, x: PETSc.Vec, d: PETSc.Vec, slope: float, end: float, trial: State) -> Step:
        """Return the full step to ``trial``, whose slope is ``end``, or a better longer one."""
        longer = self._admissible(x, d, min(_LONGEST, slope / (slope - end)))
        if longer <= 1:
            return Step(trial, 1.0)
        full = self._copy(trial)
        trial_energy = self.evaluate_energy(x, d, longer, trial)
        lower = isfinite(trial_energy) and trial_energy <= full.energy
        if lower and abs(self._evaluate_slope(d, trial)) < abs(end):
            return Step(trial, longer)
        full.copy_to(trial)
        return Step(trial, 1.0)

    def _admissible(self, x: PETSc.Vec, d: PETSc.Vec, length: float) -> float:
        """Return the part of ``length`` along ``d`` that the problem admits."""
        if not self._largest_step:
            return length
        longer = d.copy()
        longer.scale(length)
        return length * self.largest_step(x, longer)

    def _copy(self, trial: State) -> State:
        """Return a copy of ``trial``, in vectors that the next call reuses."""
        if self._stored is None:
            self._stored = State.like(trial)
        trial.copy_to(self._stored)
        return self._stored

    def _evaluate_slope(self, d: PETSc.Vec, trial: State) -> float:
        """Set the residual of ``trial``; return the energy's slope along d there."""
        self.evaluate_residual(trial)
        return float(trial.residual.dot(d))
