"""States, steps, forcing terms, the line search and the outcome of Newton's method.

`LineSearch` backtracks on the energy, also where the energy is infinite or changes by rounding
only. A forcing term is the relative tolerance of a linear solve of an inexact Newton method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import inf, isfinite

from petsc4py import PETSc

from fem_snh._petsc import factors_out_of_memory
from fem_snh.errors import NotSettled
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.protocol import SolvableProblem

#: Eisenstat & Walker 1996, choice 2: gamma and alpha, as in PETSc's -snes_ksp_ew.
GAMMA, ALPHA = 0.9, 2
#: Largest relative tolerance that the safeguard sets.
MAX_SAFEGUARD = 0.1


@dataclass
class State:
    """Unknowns with their residual and energy.

    Attributes
    ----------
    x : Vec
        The unknowns.
    residual : Vec
        The energy's gradient at ``x`` [N].
    energy : float
        The energy at ``x`` [J]; 0 without an energy.
    """

    x: PETSc.Vec
    residual: PETSc.Vec
    energy: float = 0.0

    @classmethod
    def like(cls, other: State) -> State:
        """Return a state with vectors of its own, of the same layout; their values are unset."""
        return cls(other.x.duplicate(), other.residual.duplicate())

    def copy_to(self, other: State) -> None:
        """Copy unknowns, residual and energy into ``other``."""
        self.x.copy(other.x)
        self.residual.copy(other.residual)
        other.energy = self.energy


@dataclass
class Step:
    """The result of one nonlinear iteration, or of a part of it.

    Attributes
    ----------
    end : State or None
        The caller's trial state, set to the step's end; None if no step is acceptable.
    length : float
        Length of the step, in multiples of the search direction.
    at_largest_step : bool
        Whether the length is below 1 and the largest one that the problem admits.
    slope : float or None
        Derivative of the merit function along the search direction, < 0; None if there is no
        descent direction.
    filter : str
        The Hessian's filter; "none needed" instead of "exact" if no quadrature point has a negative
        eigenvalue; "trust_region" for a step to the region's boundary; "negative curvature" for a
        step that leaves an unstable equilibrium.
    filtered_points : int
        Quadrature points with a negative eigenvalue, on all ranks.
    linear : int
        Krylov iterations of all attempts.
    lbfgs : int
        L-BFGS iterations after the step.
    diverged : int
        The SNES's converged reason if ``end`` is None.
    negative : int or None
        Negative eigenvalues of the exact Hessian, if its factors counted them.
    residual : float or None
        The relative residual of the linear system, if it was measured.
    replacement : str
        What replaced a linear solver that failed, and why; empty if nothing did.
    inaccuracy : str
        Why the solution of the linear system is not accurate enough; empty if it is or need not be.
    out_of_memory : bool
        Whether sparse factors did not fit into memory.
    """

    end: State | None = None
    length: float = 0.0
    at_largest_step: bool = False
    slope: float | None = None
    filter: str = ""
    filtered_points: int = 0
    linear: int = 0
    lbfgs: int = 0
    diverged: int = 0
    negative: int | None = None
    residual: float | None = None
    replacement: str = ""
    inaccuracy: str = ""
    out_of_memory: bool = False


@dataclass
class Iteration:
    """One Newton iteration of ``ProjectedNewton.history``.

    Attributes
    ----------
    residual : float
        Norm of the residual before the iteration [N].
    energy : float
        Energy before the iteration [J].
    filter, filtered_points, linear, lbfgs
        See `Step`.
    step : float
        Step length of the line search; 1 for a step to the trust region's boundary, 0 if it failed.
    """

    residual: float
    energy: float
    filter: str = ""
    filtered_points: int = 0
    linear: int = 0
    step: float = 0.0
    lbfgs: int = 0


@contextmanager
def relative_tolerance(ksp: PETSc.KSP, rtol: float) -> Iterator[None]:
    """Set the relative tolerance of ``ksp`` within a ``with`` block and restore it afterwards."""
    before = ksp.getTolerances()[0]
    ksp.setTolerances(rtol=rtol)
    try:
        yield
    finally:
        ksp.setTolerances(rtol=before)


class ForcingTerm:
    r"""Forcing terms of Eisenstat & Walker 1996, choice 2.

    .. math:: \eta_k = \gamma \left(\|r_k\| / \|r_{k-1}\|\right)^\alpha,
              \quad \gamma = 0.9,\ \alpha = 2,

    bounded by ``-ksp_rtol`` from below and by ``maximum`` from above.

    Near the solution the terms ask for more than Newton's tolerance :math:`\tau` requires. With the
    safeguard s > 0 they are at least :math:`s \tau / \|r_k\|`, up to 0.1 (Kelley 1995, eq. 6.20,
    has s = 0.5).

    Parameters
    ----------
    maximum : float
        Largest relative tolerance, also that of the first iteration; 0 for ``-ksp_rtol`` always.
    target : float
        s tau [N]: no linear solve needs a residual below this norm.
    """

    def __init__(self, maximum: float, target: float = 0.0) -> None:
        self.maximum, self.target = maximum, target
        self._ratio = 1.0
        self._norm: float | None = None

    def update(self, norm: float) -> None:
        """Begin a Newton iteration whose residual has this norm [N]."""
        self._ratio = norm / (norm if self._norm is None else self._norm)
        self._norm = norm

    @contextmanager
    def applied(self, ksp: PETSc.KSP) -> Iterator[None]:
        """Set the relative tolerance of ``ksp`` to the forcing term within a ``with`` block."""
        rtol = ksp.getTolerances()[0]
        if self.maximum:
            rtol = min(self.maximum, max(rtol, GAMMA * self._ratio**ALPHA))
            if self._norm:
                rtol = max(rtol, min(self.target / self._norm, MAX_SAFEGUARD))
        with relative_tolerance(ksp, rtol):
            yield


def converged_reason(snes: PETSc.SNES) -> str:
    """Return PETSc's name of the last converged reason, for example "CONVERGED_FNORM_ABS"."""
    return _name(PETSc.SNES.ConvergedReason, snes.getConvergedReason())


def failure_reason(snes: PETSc.SNES) -> str:
    """Return `converged_reason`, followed by the cause of a failure if known. Collective.

    For example "DIVERGED_LINEAR_SOLVE: DIVERGED_INDEFINITE_PC".
    """
    reason = converged_reason(snes)
    if snes.getConvergedReason() < 0 and not isfinite(snes.getSolution().norm()):
        return f"{reason}: NaN or infinity in the unknowns"
    if snes.getConvergedReason() != PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
        return reason
    return linear_failure(snes.getKSP())


def linear_failure(ksp: PETSc.KSP, step: Step | None = None) -> str:
    """Return "DIVERGED_LINEAR_SOLVE: " and its cause, from the state of ``ksp`` and ``step``."""
    reason, linear = "DIVERGED_LINEAR_SOLVE", ksp.getConvergedReason()
    if factors_out_of_memory(ksp.getPC()):
        return f"{reason}: the factors do not fit into memory"
    if step and step.inaccuracy:
        factors = "; sparse factors do not fit into memory" if step.out_of_memory else ""
        return f"{reason}: {step.inaccuracy}{factors}"
    if linear >= 0:
        return f"{reason}: no descent direction"
    return f"{reason}: {_name(PETSc.KSP.ConvergedReason, linear)}"


def out_of_memory(snes: PETSc.SNES) -> bool:
    """Return whether the last solve failed because the factors did not fit into memory."""
    failed = snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
    return failed and factors_out_of_memory(snes.getKSP().getPC())


def _name(reasons: type, code: int) -> str:
    """Return PETSc's name of a reason, or its number."""
    names = {v: k for k, v in vars(reasons).items() if isinstance(v, int)}
    return names.get(code, str(code))


@dataclass
class StepOutcome:
    """The outcome of a load step, which takes one solve or several.

    Attributes
    ----------
    converged : bool
    reason : str
        PETSc's name of the last converged reason, followed by the cause of a failure.
    residual : float
        Norm of the last residual [N].
    tolerance : float or None
        The tolerance of the last solve [N]; None without a nonlinear solve.
    history : list of Iteration
        The iterations of all solves.
    out_of_memory : bool
        Whether factors did not fit into memory, so that a shorter step fails as well.
    linear_residual : float or None
        The relative residual of the linear system of a linearised step; None for other steps.
    negative : int or None
        Negative eigenvalues of the exact Hessian at the end, beyond those of a minimum; None if
        they were not counted.
    stabilisation : float or None
        The norm of a proximal term's forces relative to the acting forces; None without the term.
    predicted : int
        Linear iterations of the predictor; 0 if it solved no linear system.
    """

    converged: bool = False
    reason: str = ""
    residual: float = 0.0
    history: list[Iteration] = field(default_factory=list)
    out_of_memory: bool = False
    linear_residual: float | None = None
    tolerance: float | None = None
    negative: int | None = None
    stabilisation: float | None = None
    predicted: int = 0

    @property
    def newton(self) -> int:
        """Number of Newton iterations; a predictor that solved a linear system counts as one."""
        return len(self.history) + (self.predicted > 0)

    @property
    def linear(self) -> int:
        """Number of linear iterations, including the predictor's."""
        return self.predicted + sum(iteration.linear for iteration in self.history)

    @property
    def lbfgs(self) -> int:
        """Number of L-BFGS iterations."""
        return sum(iteration.lbfgs for iteration in self.history)

    @property
    def left_unstable(self) -> bool:
        """Whether an iteration has followed negative curvature, away from an unstable state."""
        return any(i.filter in ("trust_region", "negative curvature") for i in self.history)

    def add_solve(self, snes: PETSc.SNES) -> None:
        """Add the last solve of ``snes``, whose result replaces the step's. Collective."""
        self.converged = snes.getConvergedReason() > 0
        context = snes.getPythonContext()
        self.reason = context.gave_up or failure_reason(snes)
        self.residual = snes.getFunctionNorm()
        self.tolerance, self.negative = context.tolerance, context.negative
        self.history += context.history
        self.out_of_memory = out_of_memory(snes)

    def fail_inner(self, error: NotSettled) -> None:
        """Mark the step as failed, with the reason "DIVERGED_INNER: " and the error's message."""
        self.converged, self.reason = False, f"DIVERGED_INNER: {error}"


def solve_until_settled(
    problem: SolvableProblem,
    snes: PETSc.SNES,
    outcome: StepOutcome,
    judge: Callable[[StepOutcome], None] | None = None,
) -> None:
    """Solve from ``problem.x``, in place, until the lagged quantities settle. Collective.

    Parameters
    ----------
    problem : SolvableProblem
    snes : SNES
        The problem's solver.
    outcome : StepOutcome
        The outcome of the step, to which each solve is added. It fails if a solve fails or lagged
        quantities do not settle.
    judge : callable, optional
        Called with the outcome before each further solve; it may mark the step as failed.
    """
    again = True
    while again:
        with callback_errors():
            snes.solve(None, problem.x)
        outcome.add_solve(snes)
        again = outcome.converged and update_lagged(problem, outcome)
        if again and judge:
            judge(outcome)
            again = outcome.converged


def update_lagged(problem: SolvableProblem, outcome: StepOutcome) -> bool:
    """Update lagged quantities after a solve; return whether to solve again. Collective.

    If the quantities do not settle, the outcome is marked as failed.
    """
    try:
        return problem.update_lagged()
    except NotSettled as error:
        outcome.fail_inner(error)
        return False


#: A change of the energy below these fractions of the energy or of E V is a rounding error. The
#: second is about 20 roundings: an energy density is a difference of numbers of size E.
_ENERGY_ROUNDING, _STIFFNESS_ROUNDING = 1e-12, 4e-15
#: The constant c of Armijo's condition (Nocedal & Wright 2006, eq. 3.4).
ARMIJO = 1e-4
#: The shortest step length.
MIN_STEP = 1e-10
#: A Newton step shorter than this shows that its quadratic model did not hold.
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
    steeply. One secant step on the slope then extends the step to at most three times its length.
    The extension costs an energy and a residual, and saves most of the linearly convergent
    iterations of clamp and abs near a solution with negative eigenvalues.

    Without an energy the search uses the residual alone. It accepts a step s with
    :math:`f(x + s d) \cdot d \le (2 c - 1)\, f(x) \cdot d`, the upper bound of Hager & Zhang.

    Where a problem does not admit all of a step, the search starts from the largest part that it
    admits, and extends it no further.

    Parameters
    ----------
    snes : SNES
        The SNES that evaluates energy and residual.
    problem : SolvableProblem
        Defines the admissible steps and their paths. The rounding error of its energy is
        proportional to E V [J].
    """

    def __init__(
        self,
        snes: PETSc.SNES,
        problem: SolvableProblem,
    ) -> None:
        self.snes, self.problem, self.has_energy = snes, problem, problem.has_energy
        self._least_change = _STIFFNESS_ROUNDING * problem.force_scale * problem.length
        self._largest_step, self._retraction = problem.largest_step, problem.retraction
        self._prescribe = problem.step_end
        self._stored: State | None = None

    def slope(self, f: PETSc.Vec, d: PETSc.Vec, Ad: PETSc.Vec) -> float | None:
        """Return the energy's slope f.d along d; None unless f.d < 0 and d.Ad > 0."""
        # PETSc's CG can miss an indefinite matrix, so the curvature along d is checked here.
        slope = float(f.dot(d))
        return slope if slope < 0 < Ad.dot(d) else None

    def search(self, start: State, d: PETSc.Vec, slope: float, trial: State) -> Step:
        """Return an acceptable step from ``start`` along ``d``; ``slope`` = f.d < 0. Collective.

        The step's end is ``trial``, which is always overwritten, or None without a step.
        """
        first, energy = self.largest_step(start.x, d), start.energy
        step = first
        while step >= MIN_STEP:
            trial_energy = self.evaluate_energy(start.x, d, step, trial)
            change = trial_energy - energy
            if not isfinite(trial_energy):
                step *= _LEAST_CUT
                continue
            rounding = self.is_rounding(change, energy)
            if rounding or change <= ARMIJO * step * slope:
                end = self._evaluate_slope(d, trial)
                if not rounding or end <= (2 * ARMIJO - 1) * slope:
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
        """Whether steps end on curved paths, so that differences of the unknowns are not steps."""
        return self._retraction is not None and self._retraction.exact

    def admits(self, x: PETSc.Vec, end: PETSc.Vec) -> bool:
        """Return whether the problem admits the straight step from ``x`` to ``end``."""
        return not self._largest_step or self._largest_step(x, end - x) == 1

    def is_rounding(self, change: float, energy: float) -> bool:
        """Return whether a change of the energy is within its rounding error."""
        size = max(abs(energy), abs(energy + change))
        return abs(change) <= max(_ENERGY_ROUNDING * size, self._least_change)

    def evaluate_energy(self, x: PETSc.Vec, d: PETSc.Vec, step: float, trial: State) -> float:
        """Set the unknowns and the energy of ``trial`` at a step's end; return the energy [J].

        The step follows the problem's curved path if the path's end is admissible from ``x``.
        Otherwise the step is straight, x + step d, or the energy is infinite if steps must follow
        the path. Without an energy the result is 0.
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
        """Compute the residual of ``trial``. Collective."""
        self.snes.computeFunction(trial.x, trial.residual)

    @staticmethod
    def _shortened(step: float, change: float, slope: float) -> float:
        """Return the length that minimises the parabola through both energies and the slope."""
        parabola = change - step * slope
        best = -slope * step**2 / (2 * parabola) if parabola > 0 else step
        return min(_LEAST_CUT * step, max(_MOST_CUT * step, best))

    def _extended(self, x: PETSc.Vec, d: PETSc.Vec, slope: float, end: float, trial: State) -> Step:
        """Return the full step, or a longer one with less energy and a smaller slope at its end.

        ``trial``, the end of the full step with the slope ``end``, becomes that of the result.
        """
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
        """Return the largest admissible length along ``d``, at most ``length``."""
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
