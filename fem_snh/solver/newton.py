"""Projected Newton as a PETSc SNES: filter policy, forcing, convergence, history.

`ProjectedNewton` is a context for a SNES of type "python". It uses only what the SNES was given
(function, Jacobian, objective, KSP), so monitors, converged reasons, ``-snes_view``, convergence
tests and options work as for PETSc's own types.
"""

from __future__ import annotations

from math import isfinite
from typing import Any

from petsc4py import PETSc

from fem_snh.solver import options
from fem_snh.solver.direction import Directions, Iteration
from fem_snh.solver.line_search import LineSearch
from fem_snh.solver.quasi_newton import Corrections
from fem_snh.solver.saddle_point import SaddleSearch
from fem_snh.solver.trust_region import TrustRegion

Reason = PETSc.SNES.ConvergedReason


class ProjectedNewton:
    """Newton's method on an energy, with Hessians filtered as a policy says.

    exact     never filtered; a direction that is not downhill is a failure
    clamp     negative eigenvalues -> 0 at every quadrature point (the paper)
    abs       negative eigenvalues -> their absolute value
    adaptive  exact while the linear solver finds no negative curvature, filtered when it does
    trust     as adaptive; when filtered steps gain little, exact within a trust region: negative
              curvature is followed, see `TrustRegion`; with `Corrections` between Newton's steps

    Convergence: ||residual||_2 <= snes_scaled_tol * force_scale with force_scale = E V^(2/3), the
    same for a body of any size and stiffness; ``-snes_atol`` [N] adds an absolute tolerance, and
    ``-snes_rtol``, ``-snes_stol`` theirs, as PETSc defines them.

    See `Directions` for the linear solves, `LineSearch` for the steps.
    """

    directions = Directions

    def __init__(
        self,
        jacobian: Any,
        force_scale: float = 1.0,
        energy_scale: float = 0.0,
        has_energy: bool = True,
        saddle: Any = None,
    ) -> None:
        """``jacobian(x, filter)`` fills the SNES's matrix; it returns the points filtered.

        ``has_energy``: whether the SNES has an objective; if not, the line search is on the
        residual. ``saddle``: of a problem that is one, see `SaddleSearch`.
        """
        self.saddle = saddle
        self._fill, self.has_energy = jacobian, has_energy
        self.force_scale, self.energy_scale = force_scale, energy_scale
        self.options = dict(options.OPTIONS)
        self.history: list[Iteration] = []
        self.filter = "exact"
        self.within_region: PETSc.KSP | None = None  # the linear solver of `TrustRegion`
        self.divergence_asked_for = False

    # --- what PETSc calls ------------------------------------------------------------------------

    def setFromOptions(self, snes: PETSc.SNES) -> None:
        prefix = snes.getOptionsPrefix()
        asked = PETSc.Options(prefix).hasName("snes_divergence_tolerance")
        self.divergence_asked_for = asked
        self.options = options.read(prefix, self.options)
        what = "a saddle (Taylor-Hood)" if self.saddle else "a material without an energy"
        options.check(self.options, "" if self.has_energy and not self.saddle else what)

    def view(self, snes: PETSc.SNES, viewer: PETSc.Viewer) -> None:
        if viewer.getType() == PETSc.Viewer.Type.ASCII:
            viewer.printfASCII("  projected Newton with a line search\n")
            for name, value in self.options.items():
                viewer.printfASCII(f"  {name} = {value}\n")
            # PETSc's own count below stays 0: only its built-in types can add to it.
            linear = sum(iteration.linear for iteration in self.history)
            viewer.printfASCII(f"  linear iterations of the last solve = {linear}\n")

    def jacobian(self, snes: PETSc.SNES, x: PETSc.Vec, A: PETSc.Mat, P: PETSc.Mat) -> None:
        """The SNES's Jacobian callback: filtered as the current iteration asks."""
        self.filtered_points = self._fill(x, self.filter)

    def solve(self, snes: PETSc.SNES, b: PETSc.Vec | None, x: PETSc.Vec) -> None:
        f = snes.getFunction()[0]
        d = x.duplicate()
        line = self._line_search(snes, x, f)
        self.history = []

        def fill(x: PETSc.Vec, filter: str) -> int:
            self.filter = filter
            snes.computeJacobian(x, *snes.getJacobian()[:2])
            return self.filtered_points

        directions = self.directions(snes, fill, line, self.options, self.history, self.saddle)
        most = int(float(self.options["snes_corrections"]))
        region = self.within_region if self.options["snes_hessian"] == "trust" else None
        corrections = Corrections(region or snes.getKSP(), line, most, self._goal)
        trust = TrustRegion(directions, region, corrections) if region else None
        energy = snes.computeObjective(x) if self.has_energy else 0.0
        if not isfinite(energy):
            snes.setIterationNumber(0)  # not those of an earlier solve
            snes.setFunctionNorm(energy)
            snes.setConvergedReason(Reason.DIVERGED_FUNCTION_DOMAIN)
            return
        snes.computeFunction(x, f)
        norm, step_norm = f.norm(), 0.0
        last = snes.getTolerances()[3]
        for its in range(last + 1):
            if self._test(snes, its, x.norm(), step_norm, norm):
                return
            if its == last:
                break
            now = Iteration(residual=norm, energy=energy)
            self.history.append(now)
            found = None
            if trust and trust.called:
                found = trust.step(x, f, d, energy, now)
            if found is None:  # no region is called, or in none is a better state to be found
                slope = directions.find(x, f, d, now)
                if slope is None:
                    snes.setConvergedReason(Reason.DIVERGED_LINEAR_SOLVE)
                    return
                found = line.search(x, d, energy, slope)
                if found and not trust:
                    end, now.corrections = corrections.improve(norm, found[1])
                    found = found[0], end
            if found is None:
                snes.setConvergedReason(Reason.DIVERGED_LINE_SEARCH)
                return
            now.step, energy = found
            if trust:
                trust.look(now, energy)
            directions.judge(now)
            if now.corrections:
                d.waxpy(-1.0, x, line.trial)
            line.trial.copy(x)
            line.f_trial.copy(f)
            step_norm = d.norm() * (1.0 if now.corrections else now.step)
            norm = f.norm()
            PETSc.garbage_cleanup(x.comm)  # petsc4py 3.18 frees what was dropped only if told to
        snes.setConvergedReason(Reason.DIVERGED_MAX_IT)

    # --- its parts -------------------------------------------------------------------------------

    def _line_search(self, snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> LineSearch:
        common = (
            snes,
            x.duplicate(),
            f.duplicate(),
            self.energy_scale,
            self.has_energy,
            float(self.options["snes_armijo"]),
            float(self.options["snes_min_step"]),
        )
        return SaddleSearch(*common, self.saddle) if self.saddle else LineSearch(*common)

    @property
    def _goal(self) -> float:
        """The residual's norm [N] of a solution."""
        return float(self.options["snes_scaled_tol"]) * self.force_scale

    def _test(self, snes: PETSc.SNES, its: int, x: float, step: float, norm: float) -> bool:
        """Tell the SNES where it is; whether to stop, for PETSc's reasons or the scaled one."""
        snes.setIterationNumber(its)
        snes.setFunctionNorm(norm)
        snes.logConvergenceHistory(norm)
        reason = snes.callConvergenceTest(its, x, step, norm)
        if reason == Reason.DIVERGED_DTOL and not self.divergence_asked_for:
            reason = 0  # away from an unstable state the residual grows while the energy falls
        if norm <= self._goal:
            reason = Reason.CONVERGED_FNORM_ABS
        snes.setConvergedReason(reason)
        snes.monitor(its, norm)
        return bool(reason)
