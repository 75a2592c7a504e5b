"""Newton steps within a trust region, which follow negative curvature instead of filtering it."""

from __future__ import annotations

from functools import partial
from math import isfinite, isnan, sqrt
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import call, ffi, set_operators
from fem_snh.errors import choose
from fem_snh.linalg.direct_solver import set_direct_factors
from fem_snh.linalg.ssor_system import SSOR
from fem_snh.solver.globalization import LineSearchNewton
from fem_snh.solver.line_search import SHORT
from fem_snh.solver.options import Values
from fem_snh.solver.quasi_newton import QuasiNewton
from fem_snh.solver.saddle_point import frozen_preconditioner
from fem_snh.solver.step import State, Step

_Linear = PETSc.KSP.ConvergedReason
_INSIDE = (_Linear.CONVERGED_RTOL, _Linear.CONVERGED_ATOL)
#: Part of the unknowns that is rounding: a shorter step, which changes nothing, would be accepted
#: again and again, as the residual is the same.
_NO_STEP = 2.0**-52

#: Linear solvers that accept a radius. PETSc's gltr does too, but frees memory twice.
SOLVERS = ("stcg", "nash")


def linear_solver(A: PETSc.Mat, P: PETSc.Mat, prefix: str, direct: bool = False) -> PETSc.KSP:
    """Return the linear solver of the trust region, with the options ``trust_*``. Collective.

    ``A`` is the Hessian and ``P`` the matrix that its preconditioner is made of: `SSOR`, or with
    ``direct`` sparse factors.

    Raises
    ------
    BadInput
        For a solver that accepts no radius.
    """
    ksp = PETSc.KSP().create(A.comm)
    ksp.setOptionsPrefix(f"{prefix}trust_")
    ksp.setTolerances(rtol=1e-3, atol=0.0, max_it=20000)
    set_operators(ksp, A, P)
    ksp.setType("stcg")
    if direct:
        set_direct_factors(ksp.getPC())
    elif P.getBlockSize() == 3:
        ksp.getPC().setType(PETSc.PC.Type.PYTHON)
        ksp.getPC().setPythonContext(SSOR())
    else:  # in two dimensions
        ksp.getPC().setType(PETSc.PC.Type.SOR)
    ksp.setFromOptions()
    if ksp.getPC().getType() == PETSc.PC.Type.BJACOBI:
        ksp.getPC().setUp()  # the blocks read their options now, and only now
    choose("trust_ksp_type", ksp.getType(), SOLVERS)
    return ksp


class _Thresholds(NamedTuple):
    """The options ``-snes_tr_*`` of `fem_snh.solver.options.OPTIONS`."""

    eta1: float
    eta2: float
    eta3: float
    t1: float
    t2: float
    delta0: float
    deltamax: float
    max_attempts: float
    enter_decrease: float
    enter_residual: float
    exit_residual: float


class TrustRegion:
    r"""Newton's method with a trust region where filtered steps make little progress.

    A step in the region minimises the exact quadratic model within a radius,

    .. math:: \min_d\; f \cdot d + \tfrac12\, d \cdot H d \quad \text{for}\quad \|d\|_P \le \delta,

    by conjugate gradients that stop at the radius, or follow a direction of negative curvature to
    it (Steihaug 1983; Toint 1981; Nocedal & Wright 2006, alg. 7.2). The norm is that of the
    preconditioner P, made of the clamped Hessian, so the radius is the square root of an energy
    [J^1/2]. The ratio of the energy's decrease to the model's decides on step and radius
    (alg. 4.1). L-BFGS iterations follow each step.

    Without a radius (before the first step) the linear solver is not bounded; the length of its
    step becomes the radius. If it meets negative curvature, or if no radius gives an acceptable
    step, the clamped Hessian's step is taken.

    Far from a solution the filtered Hessian makes faster progress. The region is entered after a
    filtered step that decreases the energy by less than ``-snes_tr_enter_decrease`` of the decrease
    since the start, if it and the step before together leave more than ``-snes_tr_enter_residual``
    of the residual: near an unstable state. Where the solve has been in the region before, one such
    step is enough to enter it again. With ``-snes_hessian exact`` it is also entered where
    the exact Hessian gives no descent direction. It is exited after any step that leaves less than
    ``-snes_tr_exit_residual`` of the residual.

    Parameters
    ----------
    ordinary : LineSearchNewton
        The strategy of steps outside the region.
    ksp : KSP
        See `linear_solver`.
    quasi_newton : QuasiNewton
        The iterations after a step in the region.
    options : dict
        See `fem_snh.solver.options.OPTIONS`.

    Attributes
    ----------
    radius : float or None
        None before the first step.
    entered : bool
        Whether the next step is one in the region.
    """

    def __init__(
        self, ordinary: LineSearchNewton, ksp: PETSc.KSP, quasi_newton: QuasiNewton, options: Values
    ) -> None:
        self.ordinary, self.ksp, self.quasi_newton = ordinary, ksp, quasi_newton
        self.direction, self.line_search = ordinary.direction, ordinary.line_search
        self.snes = self.direction.snes
        given = {name: float(options[f"snes_tr_{name}"]) for name in _Thresholds._fields}
        self.thresholds = _Thresholds(**given)
        self.radius: float | None = min(given["delta0"], given["deltamax"]) or None
        self.entered, self._first_energy, self._residual_ratio = False, float("nan"), 1.0
        self._entered_before = self._unstable = False
        self._Ad: PETSc.Vec | None = None

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Take one step from ``start`` to ``trial``; ``d`` becomes the direction. Collective."""
        norm, linear = start.residual.norm(), 0
        step, tried = Step(), self.entered
        if tried:
            step = self._step_in_region(start, d, trial)
            linear = step.linear
        if step.end is None:
            step = self.ordinary.step(start, d, trial)
            step.linear += linear
            failed = step.diverged == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
            if failed and not tried and self.direction.hessian == "exact":
                ordinary, self.entered = step, True
                step = self._step_in_region(start, d, trial)
                step.linear += ordinary.linear
                step.diverged = 0 if step.end else ordinary.diverged
        if step.end is not None:
            self._update(start, norm, step, step.end)
        return step

    def leave_equilibrium(self, decrease: float) -> None:
        """Enter the region after a step along negative curvature that decreased the energy [J]."""
        self.radius = min(sqrt(abs(decrease)), self.thresholds.deltamax)
        self.entered = self._entered_before = self._unstable = True

    def _update(self, start: State, norm: float, step: Step, end: State) -> None:
        """Enter or exit the region, by the progress of a step."""
        if isnan(self._first_energy):
            self._first_energy = start.energy
        decrease, total_decrease = start.energy - end.energy, self._first_energy - end.energy
        residual_ratio = end.residual.norm() / norm
        two_steps, self._residual_ratio = residual_ratio * self._residual_ratio, residual_ratio
        if residual_ratio < self.thresholds.exit_residual:
            self.entered = False
        elif step.filter in ("clamp", "abs"):
            enough = self.thresholds.enter_decrease * total_decrease
            little_progress = decrease < enough or self._unstable
            remaining = residual_ratio if self._entered_before else two_steps
            self.entered |= little_progress and remaining > self.thresholds.enter_residual
        elif step.negative is not None:  # the exact Hessian's factors
            poor = residual_ratio > self.thresholds.enter_residual
            self.entered |= bool(step.negative and poor) or step.length < SHORT
        self._entered_before |= self.entered

    def _step_in_region(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Return the step of the exact model, or that of the clamped one if it makes none."""
        A, P = self.snes.getJacobian()[:2]
        ksp, assemble = self.ksp, self.direction.assemble
        step = Step(filtered_points=assemble(start.x, "clamp"))
        step.filter = "exact" if step.filtered_points else "none needed"
        with self.direction.forcing.applied(ksp):
            exact = partial(assemble, start.x, "exact") if step.filtered_points else None
            with frozen_preconditioner(ksp, A, P, exact):
                if self._minimise_model(start, d, trial, step):
                    self.quasi_newton.continue_from(step, start.residual.norm())
                    if step.lbfgs or d.norm() > _NO_STEP * start.x.norm():
                        return step
                    step.end, step.length = None, 0.0
            if step.filtered_points:
                step.filter = "clamp"
                assemble(start.x, "clamp")
                self.radius = None
                self._minimise_model(start, d, trial, step)
        return step

    def _minimise_model(self, start: State, d: PETSc.Vec, trial: State, step: Step) -> bool:
        """Find the model's step and adapt the radius; return whether ``step`` is complete."""
        f = start.residual
        for _ in range(int(self.thresholds.max_attempts)):
            size, reason, Ad = self._solve(f, d, step)
            if reason in _INSIDE:
                slope = self.line_search.slope(f, d, Ad)
                searched = (
                    Step() if slope is None else self.line_search.search(start, d, slope, trial)
                )
                full = searched.length >= SHORT or searched.limited
                if searched.end and (full or self.radius is None):
                    longest = max(self.radius or 0.0, searched.length * size)
                    self.radius = min(longest, self.thresholds.deltamax)
                    step.end, step.length = searched.end, searched.length
                    return True
                if self.radius is None:
                    return False
                self.radius = self.thresholds.t1 * min(self.radius, size)
            elif reason < 0 or self.radius is None:
                return False
            elif self._accept(start, d, Ad, trial):
                if step.filter == "exact":
                    step.filter = "trust_region"
                step.end, step.length = trial, 1.0
                return True
        return False

    def _solve(self, f: PETSc.Vec, d: PETSc.Vec, step: Step) -> tuple[float, int, PETSc.Vec]:
        """Set ``d`` to the model's minimum; return its norm, the solver's reason, and A d."""
        ksp, norm = self.ksp, ffi.new("double *")
        if self._Ad is None:
            self._Ad = d.duplicate()
        call("KSPCGSetRadius", ksp, self.radius or 0.0)  # 0: none
        d.set(0.0)
        try:
            ksp.solve(f, d)
        finally:
            call("KSPCGSetRadius", ksp, 0.0)
        d.scale(-1.0)
        step.linear += ksp.getIterationNumber()
        call("KSPCGGetNormD", ksp, norm)
        ksp.getOperators()[0].mult(d, self._Ad)
        return norm[0], ksp.getConvergedReason(), self._Ad

    def _accept(self, start: State, d: PETSc.Vec, Ad: PETSc.Vec, trial: State) -> bool:
        """Evaluate a step to the radius and adapt the radius; return whether it is accepted.

        Where the energies differ only by rounding, the residual's norm replaces the ratio.
        """
        assert self.radius is not None
        search, limits = self.line_search, self.thresholds
        admitted = search.largest_step(start.x, d)
        if admitted < search.min_step:
            self.radius *= limits.t1
            return False
        d.scale(admitted)
        Ad.scale(admitted)
        predicted = -(start.residual.dot(d) + Ad.dot(d) / 2)
        trial_energy = search.evaluate_energy(start.x, d, 1.0, trial)
        change, finite = trial_energy - start.energy, isfinite(trial_energy)
        rounding = finite and search.is_rounding(change, start.energy)
        ratio = -change / predicted if finite and predicted > 0 else 0.0
        if rounding or ratio >= limits.eta1:
            search.evaluate_residual(trial)
            if not rounding or trial.residual.norm() <= start.residual.norm():
                if ratio > limits.eta3 and admitted == 1:
                    self.radius = min(self.radius * limits.t2, limits.deltamax)
                elif ratio < limits.eta2 and not rounding:
                    self.radius *= limits.t1
                return True
        self.radius *= limits.t1
        return False
