"""One nonlinear iteration: with a line search, in a trust region, or with full steps.

`fem_snh.solver.newton` calls ``step`` once per iteration. L-BFGS iterations may follow a step.
"""

from __future__ import annotations

from functools import partial
from math import inf, isfinite, sqrt
from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import call, factors_out_of_memory, ffi, set_operators, vector_like
from fem_snh.errors import choose
from fem_snh.linalg.direct_solver import set_direct_factors
from fem_snh.linalg.ssor_cg import SSOR
from fem_snh.solver.saddle_point import frozen_preconditioner
from fem_snh.solver.search_direction import SearchDirection
from fem_snh.solver.step import MIN_STEP, SHORT, LineSearch, State, Step

#: L-BFGS iterations end once the residual is this fraction of its norm before the Newton step
#: (measured: python -m benchmarks negative_curvature).
_LBFGS_RTOL = 0.1


class _Memory(NamedTuple):
    """PETSc's limited-memory inverse Hessian, and vectors of an iteration.

    ``travelled`` is the sum of the steps, which replaces the unknowns where paths are curved.
    """

    inverse: PETSc.Mat
    start: State
    d: PETSc.Vec
    travelled: PETSc.Vec


class QuasiNewton:
    """L-BFGS from the end of a Newton step (Nocedal & Wright 2006, alg. 7.4 and 7.5).

    The preconditioner of the Newton step is the initial inverse Hessian. Far from a solution a
    quadratic model is accurate over a short step only, so an exact minimiser of it is not worth its
    cost. An L-BFGS iteration costs the energies and residuals of its line search and one
    application of the preconditioner: no Hessian, no factorisation, no linear solve. The
    preconditioner of a filtered Hessian is positive definite, so every direction descends. The
    iterations end once the residual is a tenth of its norm before the Newton step: Newton's method
    is faster near a solution.

    Parameters
    ----------
    ksp : KSP
        The linear solver whose preconditioner is used.
    line_search : LineSearch
    max_it : float
        The greatest number of iterations after one Newton step.
    atol : float
        The norm of the residual [N] below which the iterations end.
    """

    def __init__(self, ksp: PETSc.KSP, line_search: LineSearch, max_it: float, atol: float) -> None:
        self.max_it, self.atol = max_it, atol
        self._line_search, self._pc = line_search, ksp.getPC()
        self._memory: _Memory | None = None

    def continue_from(self, step: Step, start_norm: float) -> Step:
        """Iterate from the end of a Newton step that began at a residual of ``start_norm`` [N].

        Moves ``step.end``, counts ``step.lbfgs`` and returns ``step``. Collective.
        """
        end, enough = step.end, max(_LBFGS_RTOL * start_norm, self.atol)
        assert end is not None
        while step.lbfgs < self.max_it and end.residual.norm() > enough:
            inverse, start, d, travelled = self._allocated(end)
            if not step.lbfgs:
                call("MatLMVMReset", inverse, 0)
            end.copy_to(start)
            curved = self._line_search.follows_paths
            call("MatLMVMUpdate", inverse, travelled if curved else start.x, start.residual)
            inverse.solve(start.residual, d)
            d.scale(-1.0)
            slope = float(start.residual.dot(d))
            searched = self._line_search.search(start, d, slope, end) if slope < 0 else Step()
            if not searched.end:
                start.copy_to(end)
                break
            if curved:
                travelled.axpy(searched.length, d)
            step.lbfgs += 1
        return step

    def _allocated(self, like: State) -> _Memory:
        """Return the vectors and PETSc's matrix, created by the first call."""
        if self._memory is None:
            start, d = State.like(like), like.x.duplicate()
            inverse = PETSc.Mat().create(d.comm)
            inverse.setSizes([d.getSizes()] * 2)
            inverse.setType(PETSc.Mat.Type.LMVMBFGS)
            inverse.setUp()
            call("MatLMVMAllocate", inverse, start.x, start.residual)
            call("MatLMVMSetJ0PC", inverse, self._pc)
            self._memory = _Memory(inverse, start, d, vector_like(d))
        return self._memory


_Reason = PETSc.SNES.ConvergedReason
#: A step makes little progress if it decreases the energy by less than the first fraction of the
#: decrease since its maximum, and if this step and the step before leave more than the second
#: fraction of the residual (measured: python -m benchmarks negative_curvature).
_LITTLE_DECREASE, _MUCH_RESIDUAL = 0.03, 0.55


class NewtonProgress:
    """How far the last step has reduced energy and residual.

    Attributes
    ----------
    residual_ratio, two_steps : float
        The norm of the residual relative to that before the step, and before the last two.
    small_decrease : bool
        Whether the energy has decreased little, or not at all.
    filtered : bool
        Whether the step's Hessian was filtered.
    is_little : bool
        Whether a filtered step has decreased the energy, and has made little progress.
    """

    def __init__(self) -> None:
        self.residual_ratio = self.two_steps = 1.0
        self.small_decrease = self.filtered = self.is_little = False
        self._highest = -inf

    def update(self, norm: float, energy: float, step: Step) -> None:
        """Set the attributes after a step from a residual of this norm [N] and an energy [J]."""
        assert step.end is not None
        end = step.end.energy
        self._highest, decrease = max(self._highest, energy), energy - end
        self.small_decrease = decrease < _LITTLE_DECREASE * (self._highest - end)
        ratio = step.end.residual.norm() / norm
        self.two_steps, self.residual_ratio = ratio * self.residual_ratio, ratio
        self.filtered = step.filter in ("clamp", "abs")
        small = self.filtered and self.small_decrease and decrease > 0
        self.is_little = small and self.two_steps > _MUCH_RESIDUAL


#: Largest number of full steps: near a solution Newton's method needs 4 to 6.
_MAX_FULL_STEPS = 15
#: Largest residual of full steps, relative to the first residual: a point that comes into contact
#: changes forces by a stiffness, not by orders of magnitude.
_MOST_GROWTH = 1e3


class LineSearchNewton:
    """The globalization by a line search along the search direction, then L-BFGS iterations.

    Parameters
    ----------
    direction : SearchDirection
    quasi_newton : QuasiNewton, optional
        The L-BFGS iterations; None for none.
    """

    def __init__(self, direction: SearchDirection, quasi_newton: QuasiNewton | None = None) -> None:
        self.direction, self.quasi_newton = direction, quasi_newton

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Return a step from ``start``; its end is ``trial``, or None if it fails. Collective.

        ``d`` becomes the search direction; ``trial`` is always overwritten.
        """
        norm, step = start.residual.norm(), self._search(start, d, trial)
        if not self.direction.accepts(norm, step):
            linear, step = step.linear, self._search(start, d, trial)
            step.linear += linear
        if step.end is not None and self.quasi_newton is not None:
            self.quasi_newton.continue_from(step, norm)
        return step

    def _search(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Return the step of the line search along the direction at ``start``."""
        step = self.direction.compute(start, d)
        step.diverged = _Reason.DIVERGED_LINEAR_SOLVE
        if step.slope is not None:
            found = self.direction.line_search.search(start, d, step.slope, trial)
            step.end, step.length = found.end, found.length
            step.at_largest_step = found.at_largest_step
            step.diverged = 0 if step.end else _Reason.DIVERGED_LINE_SEARCH
        return step


class FullNewton:
    """Newton's method without a globalization: full steps with the exact Hessian.

    Full steps stay on the path of equilibria next to which they start, also where these are
    unstable; minimisation leaves it. An object serves one solve.

    Parameters
    ----------
    direction : SearchDirection
        Assembles the Hessian and evaluates the steps.
    ksp : KSP
        A direct solver for the Hessian, which may not be symmetric.
    """

    def __init__(self, direction: SearchDirection, ksp: PETSc.KSP) -> None:
        self._direction, self._ksp, self._count, self._largest = direction, ksp, 0, 0.0

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Return the full step from ``start`` to ``trial``, or its admissible part. Collective.

        ``d`` becomes the full step. The end is None if the factors fail, if the residual is 1,000
        times the first one, or after 15 steps.
        """
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


_Linear = PETSc.KSP.ConvergedReason
_INSIDE = (_Linear.CONVERGED_RTOL, _Linear.CONVERGED_ATOL)
#: A step of the trust region below this fraction of the unknowns' norm changes nothing: it would be
#: accepted again and again, as the residual stays the same.
_NO_STEP = 2.0**-52

#: Ratios of the energy's decrease to the model's: a step is accepted from eta1, the radius shrinks
#: below eta2 and grows above eta3 (Nocedal & Wright 2006, alg. 4.1; the names and the value of eta3
#: are those of PETSc's SNESNEWTONTR).
_ETA1, _ETA2, _ETA3 = 0.05, 0.05, 0.75
#: Factors by which the radius shrinks and grows.
_SHRINK, _GROW = 0.5, 2.0
#: Radii that are tried before the clamped Hessian's step is taken.
_MAX_ATTEMPTS = 12
#: The region is exited if a step leaves less than this fraction of the residual (measured:
#: python -m benchmarks negative_curvature).
_EXIT_RESIDUAL = 0.1

#: Linear solvers that accept a radius. PETSc's gltr does too, but frees memory twice.
SOLVERS = ("stcg", "nash")


def trust_region_solver(A: PETSc.Mat, P: PETSc.Mat, prefix: str, direct: bool = False) -> PETSc.KSP:
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
    ksp.setType("stcg")
    if direct:
        set_direct_factors(ksp.getPC())
    else:
        ksp.getPC().setType(PETSc.PC.Type.PYTHON)
        ksp.getPC().setPythonContext(SSOR())
    ksp.setFromOptions()
    if ksp.getPC().getType() == PETSc.PC.Type.BJACOBI:
        set_operators(ksp, A, P)
        ksp.getPC().setUp()  # the blocks read their options now, and only now
    choose("trust_ksp_type", ksp.getType(), SOLVERS)
    return ksp


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
    step becomes the radius. If the solver then meets negative curvature, or if no radius gives an
    acceptable step, the clamped Hessian's step is taken.

    Far from a solution the filtered Hessian makes faster progress. The region is entered after a
    filtered step of little progress (`NewtonProgress`): near an unstable state. Once the solve has
    been in the region, it is enough that the last step alone leaves much of the residual. With
    sparse factors the region is also entered after an exact step that is shorter than `SHORT`, or
    leaves more than 0.55 of the residual where eigenvalues are negative; with
    ``-snes_hessian exact``, where there is no descent direction. The region is exited after any
    step that leaves less than a tenth of the residual.

    Parameters
    ----------
    direction : SearchDirection
        The search directions of steps outside the region.
    ksp : KSP
        See `trust_region_solver`.
    quasi_newton : QuasiNewton
        The iterations after a step in the region.

    Attributes
    ----------
    radius : float or None
        The radius [J^1/2]; None before the first step.
    entered : bool
        Whether the next step is taken in the region.
    """

    def __init__(
        self, direction: SearchDirection, ksp: PETSc.KSP, quasi_newton: QuasiNewton
    ) -> None:
        self.ksp, self.quasi_newton = ksp, quasi_newton
        self.direction, self.line_search = direction, direction.line_search
        self.ordinary = LineSearchNewton(direction)
        self.radius: float | None = None
        self.entered = self._entered_before = self._unstable = False
        self._Ad: PETSc.Vec | None = None

    def step(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Return a step from ``start``, as `LineSearchNewton.step`. Collective."""
        step, tried, linear = Step(), self.entered, 0
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
        return step

    def leave_equilibrium(self, decrease: float) -> None:
        """Enter the region; the ``decrease`` [J] along negative curvature sets the radius."""
        self.radius = sqrt(abs(decrease))
        self.entered = self._entered_before = self._unstable = True

    def update(self, step: Step, progress: NewtonProgress) -> None:
        """Set `entered` by the progress of the last step."""
        if progress.residual_ratio < _EXIT_RESIDUAL:
            self.entered = False
        elif progress.filtered:
            ratio = progress.residual_ratio if self._entered_before else progress.two_steps
            little = progress.small_decrease or self._unstable
            self.entered |= little and ratio > _MUCH_RESIDUAL
        elif step.negative is not None:  # the exact Hessian's factors
            poor = progress.residual_ratio > _MUCH_RESIDUAL
            self.entered |= bool(step.negative and poor) or step.length < SHORT
        self._entered_before |= self.entered

    def _step_in_region(self, start: State, d: PETSc.Vec, trial: State) -> Step:
        """Return the step of the exact model, or the clamped model's step if there is none."""
        A, P = self.direction.snes.getJacobian()[:2]
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
        """Find an acceptable step of the model, adapt the radius; return whether there is one.

        Sets ``d``, ``trial`` and ``step``.
        """
        f = start.residual
        for _ in range(_MAX_ATTEMPTS):
            size, reason, Ad = self._solve(f, d, step)
            if reason in _INSIDE:
                slope = self.line_search.slope(f, d, Ad)
                searched = (
                    Step() if slope is None else self.line_search.search(start, d, slope, trial)
                )
                full = searched.length >= SHORT or searched.at_largest_step
                if searched.end and (full or self.radius is None):
                    self.radius = max(self.radius or 0.0, searched.length * size)
                    step.end, step.length = searched.end, searched.length
                    return True
                if self.radius is None:
                    return False
                self.radius = _SHRINK * min(self.radius, size)
            elif reason < 0 or self.radius is None:
                return False
            elif self._accept(start, d, Ad, trial):
                if step.filter == "exact":
                    step.filter = "trust_region"
                step.end, step.length = trial, 1.0
                return True
        return False

    def _solve(self, f: PETSc.Vec, d: PETSc.Vec, step: Step) -> tuple[float, int, PETSc.Vec]:
        """Minimise the model in ``d``; return the P-norm of ``d``, the KSP's reason, and A d."""
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
        """Evaluate a step to the radius and adapt the radius; return whether the step is accepted.

        Scales ``d`` and ``Ad`` to the admissible part. Where the energies differ only by rounding,
        the residual's norm replaces the ratio.
        """
        assert self.radius is not None
        search = self.line_search
        admitted = search.largest_step(start.x, d)
        if admitted < MIN_STEP:
            self.radius *= _SHRINK
            return False
        d.scale(admitted)
        Ad.scale(admitted)
        predicted = -(start.residual.dot(d) + Ad.dot(d) / 2)
        trial_energy = search.evaluate_energy(start.x, d, 1.0, trial)
        change, finite = trial_energy - start.energy, isfinite(trial_energy)
        rounding = finite and search.is_rounding(change, start.energy)
        ratio = -change / predicted if finite and predicted > 0 else 0.0
        if rounding or ratio >= _ETA1:
            search.evaluate_residual(trial)
            if not rounding or trial.residual.norm() <= start.residual.norm():
                if ratio > _ETA3 and admitted == 1:
                    self.radius *= _GROW
                elif ratio < _ETA2 and not rounding:
                    self.radius *= _SHRINK
                return True
        self.radius *= _SHRINK
        return False
