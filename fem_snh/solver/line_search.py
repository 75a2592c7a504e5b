"""A backtracking line search on the energy that survives rounding, infinity and stiff Hessians."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from math import isfinite

from petsc4py import PETSc

#: Change of the energy below which its sign is rounding: relative to the energy, and to E V. The
#: latter, as an energy density is a difference of numbers of size E, however small the strain.
_NOISE, _ROUNDING = 1e-12, 4e-15
#: A Newton step that has to be shorter than this was out of the range of its model.
SHORT = 0.25
#: A full step is lengthened where the slope at its end is still this fraction of that at its start.
_STEEP = 0.3


@dataclass
class LineSearch:
    """Finds a step along d that lowers the energy; ``trial`` and ``f_trial`` hold state, residual.

    ``energy_scale`` is E V [J], the size of the numbers that the energy is the small difference of.

    Backtracks to the minimum of the parabola through both energies and the slope (between a tenth
    and half of the step); by halves where the energy is infinite. Where the energy no longer
    changes in floating point, Armijo's condition is put on the slopes at both ends instead (Hager &
    Zhang 2005, eq. 4.1; Longva et al. 2023 for projected Newton).

    A filtered Hessian is too stiff, so a full step may end where the energy still falls steeply:
    one secant step on the slope then goes on, up to three times as far. It costs an energy and a
    residual, and saves most of the linearly convergent iterations of clamp and abs near a solution
    with negative eigenvalues.

    Without an energy (``has_energy``) the search is on the residual alone: it goes along d until
    the residual there no longer points further back than it did forward at the start.
    """

    snes: PETSc.SNES
    trial: PETSc.Vec
    f_trial: PETSc.Vec
    energy_scale: float = 0.0
    has_energy: bool = True
    armijo: float = 1e-4
    min_step: float = 1e-10

    def slope(self, f: PETSc.Vec, d: PETSc.Vec, Ad: PETSc.Vec) -> float | None:
        """The energy's slope f.d < 0, or None if A shows negative curvature along d."""
        # PETSc's CG can miss an indefinite matrix: look at the curvature along d, too.
        slope = float(f.dot(d))
        return slope if slope < 0 < Ad.dot(d) else None

    def search(
        self, x: PETSc.Vec, d: PETSc.Vec, energy: float, slope: float
    ) -> tuple[float, float] | None:
        """From ``x`` with ``energy`` and ``slope`` = f.d < 0: (step, energy there), or None."""
        step = 1.0
        while step >= self.min_step:
            there = self.energy_at(x, d, step)
            change = there - energy
            if not isfinite(there):
                step *= 0.5
                continue
            flat = self.flat(change, energy)
            if flat or change <= self.armijo * step * slope:
                end = self._slope(d)
                if not flat or end <= (2 * self.armijo - 1) * slope:
                    if step == 1.0 and slope < end < _STEEP * slope:
                        return self._lengthen(x, d, there, slope, end)
                    return step, there
                if not self.has_energy:
                    step *= min(0.5, max(0.1, slope / (slope - end)))  # the secant's zero
                    continue
            step = self._shorter(step, change, slope)
        return None

    def flat(self, change: float, energy: float) -> bool:
        """Whether a change of the energy may be rounding."""
        size = max(abs(energy), abs(energy + change))
        return abs(change) <= max(_NOISE * size, _ROUNDING * self.energy_scale)

    @staticmethod
    def _shorter(step: float, change: float, slope: float) -> float:
        """The minimum of the parabola, between a tenth and half of the step."""
        parabola = change - step * slope
        best = -slope * step**2 / (2 * parabola) if parabola > 0 else step
        return min(0.5 * step, max(0.1 * step, best))

    def _lengthen(
        self, x: PETSc.Vec, d: PETSc.Vec, energy: float, slope: float, end: float
    ) -> tuple[float, float]:
        """From a full step with ``energy`` and slope ``end``: the better of it and a longer one."""
        kept, f_kept = self._kept
        self.trial.copy(kept)
        self.f_trial.copy(f_kept)
        longer = min(3.0, slope / (slope - end))
        there = self.energy_at(x, d, longer)
        if isfinite(there) and there <= energy and abs(self._slope(d)) < abs(end):
            return longer, there
        kept.copy(self.trial)
        f_kept.copy(self.f_trial)
        return 1.0, energy

    @cached_property
    def _kept(self) -> tuple[PETSc.Vec, PETSc.Vec]:
        """Where a state and its residual wait."""
        return self.trial.duplicate(), self.f_trial.duplicate()

    def energy_at(self, x: PETSc.Vec, d: PETSc.Vec, step: float) -> float:
        """Put x + step d into ``trial``; the energy there, 0 where there is none."""
        d.copy(self.trial)
        self.trial.aypx(step, x)
        if not self.has_energy:
            return 0.0
        return float(self.snes.computeObjective(self.trial))

    def _slope(self, d: PETSc.Vec) -> float:
        """Put the residual at ``trial`` into ``f_trial``; the energy's slope along d there."""
        self.snes.computeFunction(self.trial, self.f_trial)
        return float(self.f_trial.dot(d))
