r"""Improve the solution of a linear system until its residual, which is measured, is small enough.

A Krylov solver estimates its residual in a norm of its own and by a recurrence. With rounding in
single precision, a preconditioner far from the matrix, or a breakdown, the estimate may be small
while the residual :math:`f + A d` is not. `improve` computes that residual in double precision. It
first refines the solution with the same solver (iterative refinement, Wilkinson 1963), then solves
by flexible GMRES with sparse factors as its preconditioner.
"""

from __future__ import annotations

from collections.abc import Callable
from math import inf, isfinite

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import factors_out_of_memory
from fem_snh.linalg.direct_solver import set_direct_factors

#: A refinement cycle that leaves more than this part of the residual is the last one.
_MIN_REDUCTION = 0.5
#: Bounds of a cycle's relative tolerance. The solver's norm is not that of the residual, so a cycle
#: aims at a quarter of what remains to be gained.
_CYCLE_RTOL, _CYCLE_SHARE = (1e-4, 0.1), 0.25
#: Iterations with sparse factors: one in exact arithmetic, another for each matrix of rank one that
#: the factors leave out, and a few for rounding errors.
_FACTORS_MAX_IT = 20
#: Rounding errors of f + A d relative to ||A|| ||d||, a few units in the last place.
_ROUNDING = 8 * float(np.finfo(float).eps)
#: The relative residual that a large ||A|| ||d|| never excuses.
_LARGEST_ROUNDING = 1e-3

#: ``solve(r, e, rtol)`` sets e to a solution of A e = -r.
Solve = Callable[[PETSc.Vec, PETSc.Vec, float], None]


class Solution:
    """The solution of A d = -f that `improve` makes better.

    Parameters
    ----------
    A, P : Mat
        The operator, and the assembled matrix, which is the operator or a part of it.
    f, d : Vec
        The right-hand side, and the solution, in place.

    Attributes
    ----------
    relative : float
        ||f + A d|| / ||f||; infinity if d is not finite.
    linear : int
        Iterations with sparse factors.
    factorised : bool
        Whether the solution is that of the sparse factors.
    out_of_memory : bool
        Whether the factors did not fit into memory.
    """

    def __init__(self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec) -> None:
        self.A, self.P, self.f, self.d = A, P, f, d
        self.residual, self._norm = f.duplicate(), f.norm()
        self.linear, self.factorised, self.out_of_memory = 0, False, False
        self.measure()

    def measure(self) -> float:
        """Compute the residual f + A d; return its norm relative to that of f. Collective."""
        self.A.mult(self.d, self.residual)
        self.residual.axpy(1.0, self.f)
        norm = self.residual.norm() if isfinite(self.d.norm()) else inf
        self.relative = norm / self._norm if self._norm > 0 else 0.0
        return self.relative

    def attainable(self, rtol: float) -> float:
        """Return ``rtol``, or the relative residual that rounding permits if it is larger."""
        if not self._norm > 0 or not isfinite(self.relative):
            return rtol
        size = self.P.norm(PETSc.NormType.INFINITY) * self.d.norm() / self._norm
        return max(rtol, min(_ROUNDING * size, _LARGEST_ROUNDING))


def improve(
    solution: Solution, solve: Solve, rtol: float, accept: Callable[[], bool], factorise: bool
) -> bool:
    """Improve a solution until it is accepted; return whether it is. Collective.

    Parameters
    ----------
    solution : Solution
        The solution, in place.
    solve : callable
        The solver that is used for refinement: see `Solve`.
    rtol : float
        The relative residual beyond which refinement is not continued.
    accept : callable
        Returns whether the present solution is good enough; it is called after each improvement.
    factorise : bool
        Whether sparse factors are tried where refinement fails.
    """
    if accept():
        return True
    step = solution.d.duplicate()
    while isfinite(solution.relative) and solution.relative > rtol:
        before, previous = solution.relative, solution.d.copy()
        goal = min(max(_CYCLE_SHARE * rtol / before, _CYCLE_RTOL[0]), _CYCLE_RTOL[1])
        solve(solution.residual, step, goal)
        solution.d.axpy(1.0, step)
        if not solution.measure() < before:
            previous.copy(solution.d)
            solution.measure()
            break
        if accept():
            return True
        if solution.relative > _MIN_REDUCTION * before:
            break
    return factorise and _solve_with_factors(solution) and accept()


def _solve_with_factors(solution: Solution) -> bool:
    """Replace a solution by one with sparse factors if it is better; return whether it is."""
    ksp, iterated, before = (
        PETSc.KSP().create(solution.d.comm),
        solution.d.copy(),
        solution.relative,
    )
    try:
        ksp.setOperators(solution.A, solution.P)
        ksp.setType(PETSc.KSP.Type.FGMRES)
        ksp.setTolerances(rtol=_ROUNDING, atol=0.0, max_it=_FACTORS_MAX_IT)
        set_direct_factors(ksp.getPC())
        solution.d.set(0.0)
        ksp.solve(solution.f, solution.d)
        solution.d.scale(-1.0)
        solution.linear += ksp.getIterationNumber()
        solution.out_of_memory = factors_out_of_memory(ksp.getPC())
    finally:
        ksp.destroy()
    if not solution.measure() < before:
        iterated.copy(solution.d)
        solution.measure()
        return False
    solution.factorised = True
    return True
