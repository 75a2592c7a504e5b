"""Relative tolerances of linear solves: the forcing terms of an inexact Newton method."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from petsc4py import PETSc

#: Eisenstat & Walker 1996, choice 2: gamma and alpha, as in PETSc's -snes_ksp_ew.
GAMMA, ALPHA = 0.9, 2
#: The safeguard allows no larger relative tolerance than this.
MAX_SAFEGUARD = 0.1


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
