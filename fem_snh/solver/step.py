"""What the parts of Newton's method exchange: states, steps, forcing terms; the outcome of a step.

A forcing term is the relative tolerance of a linear solve of an inexact Newton method.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from petsc4py import PETSc

from fem_snh._petsc import factors_out_of_memory
from fem_snh.errors import NotSettled
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.protocol import SolvableProblem

#: Eisenstat & Walker 1996, choice 2: gamma and alpha, as in PETSc's -snes_ksp_ew.
GAMMA, ALPHA = 0.9, 2
#: The safeguard allows no larger relative tolerance than this.
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
        """Copy unknowns, residual and energy."""
        self.x.copy(other.x)
        self.residual.copy(other.residual)
        other.energy = self.energy


@dataclass
class Step:
    """One nonlinear iteration, or a part of it; the vector of its search direction is the caller's.

    Attributes
    ----------
    end : State or None
        The state at its end, which is the caller's trial state; None if no step is acceptable.
    length : float
        Length of the step, in multiples of the search direction.
    limited : bool
        Whether the problem admitted no longer one.
    slope : float or None
        Derivative of the merit function along the search direction, < 0; None if there is no
        descent direction.
    filter : str
        The filter applied to the Hessian, or "none needed"; "trust_region" for a step to the
        region's boundary.
    filtered_points : int
        Quadrature points with a negative eigenvalue.
    linear : int
        Krylov iterations of all attempts.
    lbfgs : int
        L-BFGS iterations after the step.
    diverged : int
        Without an end, the SNES's converged reason.
    negative : int or None
        Negative eigenvalues of the exact Hessian, if its factors counted them.
    residual : float or None
        The relative residual of the linear system, if it was measured.
    remedy : str
        What replaced a linear solver that failed, and why; empty if nothing did.
    lack : str
        Why the solution of the linear system is not accurate enough; empty if it is or need not be.
    out_of_memory : bool
        Whether sparse factors did not fit into memory.
    """

    end: State | None = None
    length: float = 0.0
    limited: bool = False
    slope: float | None = None
    filter: str = ""
    filtered_points: int = 0
    linear: int = 0
    lbfgs: int = 0
    diverged: int = 0
    negative: int | None = None
    residual: float | None = None
    remedy: str = ""
    lack: str = ""
    out_of_memory: bool = False


@dataclass
class Iteration:
    """One Newton iteration of ``ProjectedNewton.history``.

    Attributes
    ----------
    residual : float
        Norm of the residual before it [N].
    energy : float
        Energy before it [J].
    filter, filtered_points, linear, lbfgs
        See `Step`.
    step : float
        Step length of the line search; 1 for a step of the trust region.
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

    Near the solution they ask for more than Newton's tolerance :math:`\tau` requires. With the
    safeguard s > 0 they are at least :math:`s \tau / \|r_k\|`, up to 0.1 (Kelley 1995, eq. 6.20,
    has s = 0.5).

    Parameters
    ----------
    maximum : float
        Largest relative tolerance, also that of the first iteration; 0 for ``-ksp_rtol`` always.
    target : float
        s tau [N]: the norm of the residual below which no linear solve needs to come.
    """

    def __init__(self, maximum: float, target: float = 0.0) -> None:
        self.maximum, self.target = maximum, target
        self._ratio = 1.0
        self._norm: float | None = None

    def update(self, norm: float) -> None:
        """Begin a Newton iteration whose residual has this norm."""
        self._ratio = norm / (norm if self._norm is None else self._norm)
        self._norm = norm

    @contextmanager
    def applied(self, ksp: PETSc.KSP) -> Iterator[None]:
        """Set the iteration's relative tolerance within a ``with`` block."""
        rtol = ksp.getTolerances()[0]
        if self.maximum:
            rtol = min(self.maximum, max(rtol, GAMMA * self._ratio**ALPHA))
            if self._norm:
                rtol = max(rtol, min(self.target / self._norm, MAX_SAFEGUARD))
        with relative_tolerance(ksp, rtol):
            yield


def converged_reason(snes: PETSc.SNES) -> str:
    """Return PETSc's name for the end of the last solve: "CONVERGED_FNORM_ABS", ..."""
    return _name(PETSc.SNES.ConvergedReason, snes.getConvergedReason())


def failure_reason(snes: PETSc.SNES) -> str:
    """Return `converged_reason`, followed by its cause if the last solve failed. Collective.

    For example "DIVERGED_LINEAR_SOLVE: DIVERGED_INDEFINITE_PC".
    """
    reason = converged_reason(snes)
    if snes.getConvergedReason() < 0 and not isfinite(snes.getSolution().norm()):
        return f"{reason}: NaN or infinity in the unknowns"
    if snes.getConvergedReason() != PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE:
        return reason
    return linear_failure(snes.getKSP())


def linear_failure(ksp: PETSc.KSP, step: Step | None = None) -> str:
    """Return the reason of a step without a direction: "DIVERGED_LINEAR_SOLVE: " and its cause."""
    reason, linear = "DIVERGED_LINEAR_SOLVE", ksp.getConvergedReason()
    if factors_out_of_memory(ksp.getPC()):
        return f"{reason}: the factors do not fit into memory"
    if step and step.lack:
        factors = "; sparse factors do not fit into memory" if step.out_of_memory else ""
        return f"{reason}: {step.lack}{factors}"
    if linear >= 0:
        return f"{reason}: no descent direction"
    return f"{reason}: {_name(PETSc.KSP.ConvergedReason, linear)}"


def out_of_memory(snes: PETSc.SNES) -> bool:
    """Return whether the last solve failed because the factors did not fit into memory."""
    failed = snes.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_LINEAR_SOLVE
    return failed and factors_out_of_memory(snes.getKSP().getPC())


def _name(reasons: Any, code: int) -> str:
    """Return PETSc's name of a reason."""
    names = {v: k for k, v in vars(reasons).items() if isinstance(v, int)}
    return names.get(code, str(code))


@dataclass
class StepOutcome:
    """The outcome of the solve of a load step, of one or of several solves.

    Attributes
    ----------
    converged : bool
    reason : str
        PETSc's name for its end, followed by the cause of a failure.
    residual : float
        Norm of the last residual [N].
    tolerance : float or None
        The norm at which it has converged [N]; None without a nonlinear solve.
    history : list of Iteration
        The iterations of all solves.
    out_of_memory : bool
        Whether it failed for want of memory, so that a shorter step fails as well.
    linear_residual : float or None
        The relative residual of the linear system of a linearised step.
    negative : int or None
        Negative eigenvalues of the exact Hessian at the end, beyond those of a minimum; None if
        they were not counted.
    stabilisation : float or None
        The norm of the forces of a proximal term, over that of the forces that act; None without.
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
        """Newton iterations; the tangent predictor assembles a Hessian too, and counts as one."""
        return len(self.history) + (self.predicted > 0)

    @property
    def linear(self) -> int:
        """Linear iterations, those of the predictor included."""
        return self.predicted + sum(iteration.linear for iteration in self.history)

    @property
    def lbfgs(self) -> int:
        """L-BFGS iterations."""
        return sum(iteration.lbfgs for iteration in self.history)

    @property
    def left_unstable(self) -> bool:
        """Whether an iteration has followed negative curvature, away from an unstable state."""
        return any(i.filter in ("trust_region", "negative curvature") for i in self.history)

    def add_solve(self, snes: PETSc.SNES) -> None:
        """Add a solve of `ProjectedNewton`, whose end is now that of the step. Collective."""
        self.converged = snes.getConvergedReason() > 0
        self.reason, self.residual = failure_reason(snes), snes.getFunctionNorm()
        context = snes.getPythonContext()
        self.tolerance, self.negative = context.tolerance, context.negative
        self.history += context.history
        self.out_of_memory = out_of_memory(snes)

    def fail_inner(self, error: NotSettled) -> None:
        """Set the reason to PETSc's name of the failure of an inner solver, with its cause."""
        self.converged, self.reason = False, f"DIVERGED_INNER: {error}"


def solve_until_settled(
    problem: SolvableProblem,
    snes: PETSc.SNES,
    outcome: StepOutcome,
    judge: Callable[[StepOutcome], None] | None = None,
) -> None:
    """Solve from ``problem.x``, in place, until nothing lagged changes. Collective.

    Parameters
    ----------
    problem : SolvableProblem
    snes : SNES
        Its solver.
    outcome : StepOutcome
        The outcome of the step, to which each solve is added. It has not converged if a solve has
        not, or if lagged quantities do not settle: the reason then says which.
    judge : callable, optional
        Called with the outcome before another solve; it may make the step a failure.
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
    """Update lagged quantities after a solve; return whether to solve again. Collective."""
    try:
        return problem.update_lagged()
    except NotSettled as error:
        outcome.fail_inner(error)
        return False
