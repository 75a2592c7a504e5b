"""Steps within a trust region: negative curvature is followed instead of filtered away."""

from __future__ import annotations

from math import isfinite, isnan

from petsc4py import PETSc

from fem_snh._petsc import call, ffi
from fem_snh.errors import choose
from fem_snh.solver.direction import Directions, Iteration
from fem_snh.solver.line_search import SHORT
from fem_snh.solver.quasi_newton import CONVERGING, Corrections
from fem_snh.solver.saddle_point import preconditioner_of

_Linear = PETSc.KSP.ConvergedReason
_INSIDE = (_Linear.CONVERGED_RTOL, _Linear.CONVERGED_ATOL)
#: Of the energy's change that the model promised: to take the step, and for a larger radius.
_ENOUGH, _GOOD = 0.05, 0.75
_SHRINK, _GROW = 0.5, 2.0
#: A filtered step's part of all that was gained, below which the trust region is called; unless it
#: left less than this of the residual: it converges, then.
_LITTLE, _LEFT = 0.01, 0.5
#: Radii tried before the clamped Hessian is asked.
_ATTEMPTS = 12

#: Linear solvers that know a radius. (PETSc's gltr has one, too, and frees memory twice.)
SOLVERS = ("stcg", "nash")
#: PETSc options, unless others are given: quasi-Newton steps, and the region's linear solver.
OPTIONS = {
    "snes_corrections": 640,
    "trust_ksp_type": "stcg",
    "trust_pc_type": "bjacobi",
    "trust_sub_pc_type": "icc",
}


def linear_solver(A: PETSc.Mat, prefix: str) -> PETSc.KSP:
    """The solver of the region's steps, from the options under ``prefix`` + trust_. Collective.

    Raises BadInput for one that knows no radius.
    """
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix(f"{prefix}trust_")
    ksp.setTolerances(rtol=1e-3, atol=0.0, max_it=20000)
    ksp.setOperators(A)
    ksp.setFromOptions()
    if ksp.getPC().getType() == PETSc.PC.Type.BJACOBI:
        ksp.getPC().setUp()  # the blocks read their options, once
    choose("linear solver within a trust region, trust_ksp_type", ksp.getType(), SOLVERS)
    return ksp


class TrustRegion:
    """The step of least exact quadratic model within a radius (Steihaug 1983, Toint 1981).

    Conjugate gradients stop at the radius, along the direction of negative curvature if they meet
    one. The norm is the preconditioner's, made of the clamped Hessian; so the radius is a square
    root of energy [J^1/2]. The first step has no radius yet, and if it meets negative curvature
    it is the clamped Hessian's, as is every one for which no radius will do.

    Far from a solution the clamped Hessian goes faster. So the region is ``called`` once a filtered
    step gains less than a hundredth of what all have and leaves half of the residual: at a state
    that is nearly unstable. Once a step leaves less than a tenth of the residual, it is no more.
    """

    def __init__(self, directions: Directions, ksp: PETSc.KSP, corrections: Corrections) -> None:
        self.directions, self.ksp, self.corrections = directions, ksp, corrections
        self.snes, self.line = directions.snes, directions.line
        self.radius: float | None = None
        self.called, self._start = False, float("nan")
        self._Ad = self.line.trial.duplicate()

    def look(self, now: Iteration, energy: float) -> None:
        """See what an iteration gained that ended at ``energy``."""
        if isnan(self._start):
            self._start = now.energy
        gain, whole = now.energy - energy, self._start - energy
        left = self.line.f_trial.norm() / now.residual
        if now.filter in ("clamp", "abs"):
            self.called |= gain < _LITTLE * whole and left > _LEFT
        elif left < CONVERGING:
            self.called = False

    def step(
        self, x: PETSc.Vec, f: PETSc.Vec, d: PETSc.Vec, energy: float, now: Iteration
    ) -> tuple[float, float] | None:
        """From ``x`` along ``d``, which is found: (step, energy there), or None if there is none.

        State and residual are then in the line search's vectors.
        """
        A, P = self.snes.getJacobian()[:2]
        ksp, directions = self.ksp, self.directions
        now.filtered_points = directions.fill(x, "clamp")
        now.filter = "exact" if now.filtered_points else "none needed"
        with directions.forcing(ksp):
            with preconditioner_of(ksp, A, P):
                if now.filtered_points:
                    directions.fill(x, "exact")
                if found := self._within(x, f, d, energy, now):
                    now.step, end = found
                    end, now.corrections = self.corrections.improve(now.residual, end)
                    return now.step, end
            if now.filtered_points:
                now.filter = "clamp"
                directions.fill(x, "clamp")
                self.radius = None
                found = self._within(x, f, d, energy, now)
        return found

    def _within(
        self, x: PETSc.Vec, f: PETSc.Vec, d: PETSc.Vec, energy: float, now: Iteration
    ) -> tuple[float, float] | None:
        """The step of the present matrix, its radius found; None if there is none."""
        for _ in range(_ATTEMPTS):
            size, reason = self._solve(f, d, now)
            if reason in _INSIDE:
                slope = self.line.slope(f, d, self._Ad)
                found = None if slope is None else self.line.search(x, d, energy, slope)
                if found and (found[0] >= SHORT or self.radius is None):
                    self.radius = max(self.radius or 0.0, found[0] * size)
                    return found
                if self.radius is None:
                    return None
                self.radius = _SHRINK * min(self.radius, size)
            elif reason < 0 or self.radius is None:
                return None
            elif (there := self._judge(x, f, d, energy)) is not None:
                if now.filter == "exact":
                    now.filter = "trust"
                return 1.0, there
        return None

    def _solve(self, f: PETSc.Vec, d: PETSc.Vec, now: Iteration) -> tuple[float, int]:
        """Put the step within the radius into ``d``; its norm and why the solver ended."""
        ksp, norm = self.ksp, ffi.new("double *")
        call("KSPCGSetRadius", ksp, self.radius or 0.0)  # 0: none
        d.set(0.0)
        try:
            ksp.solve(f, d)
        finally:
            call("KSPCGSetRadius", ksp, 0.0)
        d.scale(-1.0)
        now.linear += ksp.getIterationNumber()
        call("KSPCGGetNormD", ksp, norm)
        ksp.getOperators()[0].mult(d, self._Ad)
        return norm[0], ksp.getConvergedReason()

    def _judge(self, x: PETSc.Vec, f: PETSc.Vec, d: PETSc.Vec, energy: float) -> float | None:
        """The energy after a step to the radius, or None if it is not taken; adapts the radius."""
        assert self.radius is not None
        line = self.line
        promised = -(f.dot(d) + self._Ad.dot(d) / 2)
        there = line.energy_at(x, d, 1.0)
        flat = isfinite(there) and line.flat(there - energy, energy)
        ratio = (energy - there) / promised if isfinite(there) and promised > 0 else 0.0
        if flat or ratio >= _ENOUGH:
            self.snes.computeFunction(line.trial, line.f_trial)
            if not flat or line.f_trial.norm() <= f.norm():
                self.radius *= _GROW if ratio > _GOOD else 1.0
                return there
        self.radius *= _SHRINK
        return None
