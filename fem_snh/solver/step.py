"""Data that the parts of Newton's method exchange: states, search directions, steps."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc


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
class Direction:
    """The properties of a search direction; its vector is the caller's.

    Attributes
    ----------
    slope : float or None
        Derivative of the merit function along it, < 0; None if there is no descent direction.
    filter : str
        The filter applied to the Hessian, or "none needed".
    filtered_points : int
        Quadrature points with a negative eigenvalue.
    linear : int
        Krylov iterations of all attempts.
    residual : float or None
        The relative residual of the linear system, if it was measured.
    remedy : str
        What replaced a linear solver that failed, and why; empty if nothing did.
    lack : str
        Why the solution is not accurate enough; empty if it is or need not be.
    out_of_memory : bool
        Whether sparse factors did not fit into memory.
    negative : int or None
        Negative eigenvalues of the exact Hessian, if its factors counted them.
    """

    slope: float | None = None
    filter: str = ""
    filtered_points: int = 0
    linear: int = 0
    residual: float | None = None
    remedy: str = ""
    lack: str = ""
    out_of_memory: bool = False
    negative: int | None = None


@dataclass
class Step:
    """The outcome of one nonlinear iteration, or of a part of it.

    Attributes
    ----------
    end : State or None
        The state at its end, which is the caller's trial state; None if no step is acceptable.
    length : float
        Length of the step, in multiples of the search direction.
    limited : bool
        Whether the problem admitted no longer one.
    filter, filtered_points, linear
        See `Direction`; ``filter`` is "trust_region" for a step to the region's boundary.
    lbfgs : int
        L-BFGS iterations after the step.
    diverged : int
        Without an end, the SNES's converged reason.
    negative : int or None
        See `Direction`.
    """

    end: State | None = None
    length: float = 0.0
    limited: bool = False
    filter: str = ""
    filtered_points: int = 0
    linear: int = 0
    lbfgs: int = 0
    diverged: int = 0
    negative: int | None = None


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
