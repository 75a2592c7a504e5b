"""What the parts of Newton's method exchange: states, steps, forcing terms.

A forcing term is the relative tolerance of a linear solve of an inexact Newton method.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from petsc4py import PETSc

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
