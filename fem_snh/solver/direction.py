"""Newton's directions: the Hessian filtered as a policy says, linear systems solved inexactly."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from petsc4py import PETSc

from fem_snh._petsc import NEGATIVE_CURVATURE
from fem_snh.solver.line_search import SHORT, LineSearch
from fem_snh.solver.saddle_point import preconditioner_of

_Linear = PETSc.KSP.ConvergedReason
#: How linear solvers say that the matrix, or what preconditions it, is not positive.
_INDEFINITE = (
    _Linear.DIVERGED_INDEFINITE_MAT,
    _Linear.DIVERGED_INDEFINITE_PC,
    NEGATIVE_CURVATURE,
)


@dataclass
class Iteration:
    """One Newton iteration: what it met, and what it cost."""

    residual: float  # ||residual||_2 before it [N]
    energy: float  # before it [J]
    filter: str = ""  # what was done to the Hessian
    filtered_points: int = 0  # quadrature points with a negative eigenvalue
    linear: int = 0  # Krylov iterations, all attempts
    step: float = 0.0  # of the line search
    corrections: int = 0  # quasi-Newton steps after it


class Directions:
    """d = -H^-1 f of one solve, H filtered as ``-snes_hessian`` says.

    Linear solves are inexact: their relative tolerance is 0.9 (||r_k|| / ||r_k-1||)^2, Eisenstat &
    Walker's second choice, between ``-ksp_rtol`` and ``snes_forcing_max``.
    """

    def __init__(
        self,
        snes: PETSc.SNES,
        fill: Callable[[PETSc.Vec, str], int],
        line: LineSearch,
        options: Mapping[str, str | float],
        history: Sequence[Iteration],
        saddle: Any = None,
    ) -> None:
        """``fill(x, filter)`` fills the SNES's matrices and returns the points filtered.

        ``history``: the iterations so far, the present one last.
        """
        self.snes, self.fill, self.line = snes, fill, line
        self.options, self.history, self.saddle = dict(options), history, saddle
        self._indefinite = float("inf")

    def find(self, x: PETSc.Vec, f: PETSc.Vec, d: PETSc.Vec, now: Iteration) -> float | None:
        """Put the direction at ``x`` into ``d``; its slope f.d < 0, or None if there is none."""
        policy = str(self.options["snes_hessian"])
        filters = [policy]
        if policy in ("adaptive", "trust"):
            filters = ["exact", str(self.options["snes_adaptive_filter"])]
            if now.residual > float(self.options["snes_adaptive_retry"]) * self._indefinite:
                del filters[0]
        A, P = self.snes.getJacobian()[:2]
        ksp = self.snes.getKSP()
        for now.filter in filters:
            # MINRES takes an indefinite matrix, but no indefinite preconditioner: the blocks of a
            # saddle come from the clamped Hessian, whatever the operator is.
            split = self.saddle and ksp.getPC().getType() == PETSc.PC.Type.FIELDSPLIT
            blocks = split and now.filter == "exact"
            now.filtered_points = self.fill(x, "clamp" if blocks else now.filter)
            if split:
                self.saddle.update_schur_approximation(P)
            if now.filter == "exact" and not now.filtered_points:
                now.filter = "none needed"
            with preconditioner_of(ksp, A, P) if blocks else nullcontext():
                if blocks and now.filtered_points:
                    self.fill(x, now.filter)
                slope = self._solve(A, P, f, d, now)
            if slope is not None:
                return slope
            self._indefinite = now.residual
        return None

    def judge(self, now: Iteration) -> None:
        """Learn from the step that was taken along the direction."""
        # At a saddle a direction of the exact Hessian may be downhill though H is not positive.
        if self.saddle and now.step < SHORT:
            self._indefinite = now.residual

    @contextmanager
    def forcing(self, ksp: PETSc.KSP) -> Iterator[None]:
        """Meanwhile linear solves are as loose as the present iteration asks."""
        tolerance = ksp.getTolerances()[0]
        if cap := float(self.options["snes_forcing_max"]):
            now, before = self.history[-1], self.history[-2:][0]
            ratio = now.residual / before.residual  # 1 at first
            ksp.setTolerances(rtol=min(cap, max(tolerance, 0.9 * ratio**2)))
        try:
            yield
        finally:
            ksp.setTolerances(rtol=tolerance)

    def _solve(
        self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec, now: Iteration
    ) -> float | None:
        """Solve A d = -f inexactly; f.d, or None if A showed a direction of negative curvature."""
        ksp = self.snes.getKSP()
        filtered = now.filter in ("clamp", "abs") and not self.saddle
        reason = self._try(ksp, A, P, f, d, now)
        if reason in _INDEFINITE and filtered and ksp.getType() == PETSc.KSP.Type.PYTHON:
            # That matrix has no negative eigenvalue but by the rounding of single precision, as
            # where cells are crushed and their neighbours a million times as stiff.
            self._try(self._in_double, A, P, f, d, now)
        elif reason in _INDEFINITE:
            return None
        if filtered:
            slope = float(f.dot(d))  # the matrix is not negative, though it may be singular
            return slope if slope < 0 else None
        Ad = f.duplicate()
        A.mult(d, Ad)
        return self.line.slope(f, d, Ad)

    def _try(
        self,
        ksp: PETSc.KSP,
        A: PETSc.Mat,
        P: PETSc.Mat,
        f: PETSc.Vec,
        d: PETSc.Vec,
        now: Iteration,
    ) -> int:
        """Put what a solver makes of A d = -f into ``d``; why it ended."""
        ksp.setOperators(A, P)
        d.set(0.0)
        with self.forcing(ksp):
            ksp.solve(f, d)
        d.scale(-1.0)
        now.linear += ksp.getIterationNumber()
        return int(ksp.getConvergedReason())

    @cached_property
    def _in_double(self) -> PETSc.KSP:
        """Conjugate gradients with Jacobi, as PETSc has them."""
        usual = self.snes.getKSP()
        ksp = PETSc.KSP().create(usual.comm)
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.getPC().setType(PETSc.PC.Type.JACOBI)
        rtol, atol, _, most = usual.getTolerances()
        ksp.setTolerances(rtol=rtol, atol=atol, max_it=most)
        return ksp
