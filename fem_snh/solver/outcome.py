"""The outcome of the solve of a load step."""

from __future__ import annotations

from dataclasses import dataclass, field

from petsc4py import PETSc

from fem_snh.errors import NotSettled
from fem_snh.solver.reasons import failure_reason, out_of_memory
from fem_snh.solver.step import Iteration


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
