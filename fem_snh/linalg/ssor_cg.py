"""SSOR-preconditioned conjugate gradients in single precision, with iterative refinement in double.

Newton's linear systems need a relative tolerance of 1e-1 to 1e-2 only, and the time to solve them
is memory traffic: single precision halves it. It limits the reduction of the residual in one run of
conjugate gradients. For smaller tolerances the residual b - A x is computed in double precision and
a correction is solved for (iterative refinement, Wilkinson 1963): each run is a refinement cycle.
`fem_snh.linalg.ssor_system` has the preconditioner and the steps of an iteration;
`fem_snh.linalg.deflation` solves for motions that single precision loses.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import TYPE_CHECKING

from petsc4py import PETSc

import numpy as np

from fem_snh.linalg.ssor_system import (
    AUTOMATIC,
    MAX_REPLICATED,
    ZERO_CURVATURE,
    CycleStart,
    SSORSystem,
)

if TYPE_CHECKING:
    from fem_snh.linalg.deflation import BodyModes

_Reason = PETSc.KSP.ConvergedReason
#: Residual reduction per refinement cycle. Single precision rounds to 6e-8; the remaining factor of
#: 1000 is for the accumulated rounding errors of the iterations.
_CYCLE_REDUCTION = 1e-4
#: A cycle ends where its residual is so many times its least one. In single precision deflation
#: leaves a part in its own space, which then grows until a negative curvature seems to be zero.
_MAX_GROWTH = 100.0
#: The refinement ends if a cycle does not reduce the residual at least to this fraction.
_MIN_REDUCTION = 0.5
#: Lower bound of the limit on iterations, for matrices of a few unknowns.
_MIN_ITERATION_LIMIT = 100


def context_of(ksp: PETSc.KSP) -> EisenstatCG | None:
    """Return the `EisenstatCG` of a KSP; None for another solver."""
    if ksp.getType() != PETSc.KSP.Type.PYTHON:
        return None
    context = ksp.getPythonContext()
    return context if isinstance(context, EisenstatCG) else None


class EisenstatCG:
    """A KSP of type "python" for a symmetric matrix of 2x2 or 3x3 blocks. Collective.

    The matrix is an AIJ matrix or one of `fem_snh.linalg.matrix_parts.part_of`.

    Tolerances, monitors and converged reasons are those of any KSP; the norm is the natural one,
    sqrt(r.M^-1 r). The KSP's PC is not used. With coordinates the iteration is deflated, see
    `fem_snh.linalg.deflation`; ``-ksp_deflation_subdomains`` sets the number of subdomains, and
    ``-ksp_deflation_replicated`` that above which their matrix is distributed over the ranks.

    Parameters
    ----------
    coordinates : (rows, dim), optional
        Reference coordinates of this rank's nodes; without them there is no deflation.

    Attributes
    ----------
    has_residual : bool
        Whether `residual` returns that of the last solution.

    Raises
    ------
    BadInput
        From `solve`, for a matrix whose blocks are neither 2x2 nor 3x3.

    Notes
    -----
    Beside PETSc's own the converged reason is

    - CONVERGED_HAPPY_BREAKDOWN if the matrix turns out to be singular, and a refinement cycle does
      not reduce what is left of the residual,
    - DIVERGED_INDEFINITE_MAT at a direction of negative curvature,
    - DIVERGED_INDEFINITE_PC if a diagonal block is not positive definite or a sweep overflows,
    - DIVERGED_BREAKDOWN if a refinement cycle does not reduce the residual,
    - DIVERGED_NANORINF if the matrix is not finite.
    """

    def __init__(self, coordinates: np.ndarray | None = None) -> None:
        self._coordinates, self._subdomains = coordinates, AUTOMATIC
        self._replicated = MAX_REPLICATED
        self.has_residual = False

    def create(self, ksp: PETSc.KSP) -> None:
        """Set an empty state; PETSc calls this."""
        self._made: SSORSystem | None = None
        self._modes: BodyModes | None = None
        self._state = -1  # of the matrix last used

    def setFromOptions(self, ksp: PETSc.KSP) -> None:
        """Read ``ksp_deflation_subdomains`` (0 for none, -1 by the size), ``.._replicated``."""
        options = PETSc.Options(ksp.getOptionsPrefix())
        self._subdomains = options.getInt("ksp_deflation_subdomains", AUTOMATIC)
        self._replicated = options.getInt("ksp_deflation_replicated", MAX_REPLICATED)

    @property
    def _system(self) -> SSORSystem:
        assert self._made is not None, "before `update_matrix`"
        return self._made

    def update_matrix(self, A: PETSc.Mat) -> None:
        """Update the single-precision copy of the matrix and its deflation space.

        Nothing is done if neither the matrix object nor its values changed. The sparsity pattern is
        read if it or the matrix object changed.
        """
        if self._made is None or not self._made.fits(A):
            limits = self._subdomains, self._replicated
            self._made, self._state = SSORSystem(A, self._coordinates, *limits), -1
        if self._state != A.stateGet():
            self._failure, self._state = self._system.update(A), A.stateGet()
            self._modes = None if self._failure else self._system.body_modes(A)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b from x = 0, whatever ``x`` holds."""
        A = ksp.getOperators()[0]
        self.update_matrix(A)
        system, self.has_residual = self._system, False
        x.set(0.0)
        residual, its, previous, singular = b.copy(), 0, inf, False
        ksp.setConvergedReason(_Reason.CONVERGED_ITERATING)
        ksp.setIterationNumber(0)
        if self._failure:
            ksp.setConvergedReason(self._failure)
            return
        start = system.start_cycle(residual)
        if not isfinite(start.norm):
            ksp.setConvergedReason(_Reason.DIVERGED_INDEFINITE_PC)
            return
        # The tolerance is relative to the norm of b, not to that of the deflated P b.
        self._test_convergence(ksp, its, start.norm)
        while not ksp.getConvergedReason():
            if self._modes:
                self._modes.correct(x, residual)
                its, start = its + 1, system.start_cycle(residual)
                if self._test_convergence(ksp, its, start.norm):
                    return
            if start.deflated_norm > _MIN_REDUCTION * previous:
                happy, failed = _Reason.CONVERGED_HAPPY_BREAKDOWN, _Reason.DIVERGED_BREAKDOWN
                singular &= start.deflated_norm <= previous / _MIN_REDUCTION
                ksp.setConvergedReason(happy if singular else failed)
                return
            (its, singular), previous = self._run_cycle(ksp, its, start), start.deflated_norm
            system.add_solution(x, start.unit)
            self.has_residual = True
            if not ksp.getConvergedReason():  # another refinement cycle
                A.mult(x, residual)
                residual.aypx(-1.0, b)
                self.has_residual = False
                start = system.start_cycle(residual)

    def residual(self) -> np.ndarray:
        """Return this rank's residual of the last solution, exact to single precision.

        It is known if `has_residual`.
        """
        return self._system.residual()

    def _test_convergence(self, ksp: PETSc.KSP, its: int, norm: float) -> bool:
        """Report iteration and norm to the KSP; return whether to stop."""
        ksp.setIterationNumber(its)
        ksp.setResidualNorm(norm)
        ksp.logConvergenceHistory(norm)
        reason = ksp.callConvergenceTest(its, norm)
        # In exact arithmetic CG needs at most as many iterations as unknowns; more are rounding
        # errors of a singular matrix.
        limit = min(ksp.getTolerances()[3], max(_MIN_ITERATION_LIMIT, self._system.unknowns))
        if not reason and its >= limit:
            reason = _Reason.DIVERGED_MAX_IT
        ksp.setConvergedReason(reason)
        ksp.monitor(its, norm)
        return bool(reason)

    def _run_cycle(self, ksp: PETSc.KSP, its: int, start: CycleStart) -> tuple[int, bool]:
        """Iterate (Saad 2003, alg. 9.1) until the KSP's test or the cycle's reduction.

        Returns the number of iterations so far, of which there were ``its`` before, and whether the
        last direction is in the null space.
        """
        system, beta, rho, least = self._system, 0.0, start.rho, 1.0
        if rho == 0:  # the coarse component is the whole solution
            self._test_convergence(ksp, its + 1, 0.0)
            return its + 1, False
        while True:
            curvature = system.update_direction(beta)
            singular = False
            if not 0 < curvature < inf:
                threshold = ZERO_CURVATURE * system.direction_norm_squared()
                if singular := 0 <= -curvature <= threshold:
                    curvature = threshold
                else:
                    ksp.setConvergedReason(_breakdown_reason(curvature))
                    return its, False
            new = system.update_vectors(rho / curvature)
            if not isfinite(new):
                ksp.setConvergedReason(_breakdown_reason(new))
                return its, False
            its += 1
            ratio = sqrt(max(new, 0.0) / start.rho)
            converged = self._test_convergence(ksp, its, start.deflated_norm * ratio)
            least = min(least, ratio)
            grown = _MAX_GROWTH * least < ratio <= _MIN_REDUCTION
            if converged or singular or grown or ratio <= _CYCLE_REDUCTION:
                return its, singular
            beta, rho = new / rho, new


def _breakdown_reason(value: float) -> int:
    """Return the converged reason for a curvature or norm that is negative or not finite."""
    # Sweeps over a positive definite matrix are bounded; an overflow shows an indefinite one.
    overflow = not isfinite(value)
    reason = _Reason.DIVERGED_INDEFINITE_PC if overflow else _Reason.DIVERGED_INDEFINITE_MAT
    return int(reason)
