"""The solve of a load step, again while lagged quantities change, and its outcome.

Scenes, programs and time steps have this one loop. The terms update multipliers, lagged friction
and pairs of surfaces after each solve (`fem_snh.terms.history.TermHistory`). Converged and diverged
reasons have PETSc's names.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from typing import Any

from petsc4py import PETSc

from fem_snh._petsc import factors_out_of_memory
from fem_snh.errors import NotSettled
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.step import Iteration, Step


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
