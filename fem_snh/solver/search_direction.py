r"""Compute Newton's search directions: assemble a filtered Hessian, solve the system inexactly.

Both globalizations call it once an iteration.

A Krylov solver estimates its residual in a norm of its own and by a recurrence. With rounding in
single precision, a preconditioner far from the matrix, or a breakdown, the estimate may be small
while the residual :math:`f + A d` is not. `Solution` has that residual in double precision. An
inaccurate solution is first refined with the same solver (iterative refinement, Wilkinson 1963),
then replaced by that of flexible GMRES with sparse factors as its preconditioner.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import cached_property, partial
from math import inf, isfinite
from typing import TYPE_CHECKING

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import NEGATIVE_CURVATURE, factors_out_of_memory, negative_pivots, set_operators
from fem_snh.linalg.direct_solver import set_direct_factors
from fem_snh.solver.block_triangular import BlockTriangular
from fem_snh.solver.saddle_point import (
    Blocks,
    frozen_preconditioner,
    outer_operator,
    preconditioner_by_blocks,
)
from fem_snh.solver.step import SHORT, ForcingTerm, State, Step, relative_tolerance

if TYPE_CHECKING:
    from fem_snh.solver.newton import ProjectedNewton

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

#: The exact Hessian is tried again once the residual has fallen to this part (measured: python -m
#: benchmarks negative_curvature).
_RETRY = 0.1

_Linear = PETSc.KSP.ConvergedReason
#: How linear solvers report a matrix or a preconditioner that is not positive definite.
_INDEFINITE = (
    _Linear.DIVERGED_INDEFINITE_MAT,
    _Linear.DIVERGED_INDEFINITE_PC,
    NEGATIVE_CURVATURE,
)


class Solution:
    """A solution of A d = -f, with its residual f + A d in double precision.

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
    """

    def __init__(self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec) -> None:
        self.A, self.P, self.f, self.d = A, P, f, d
        self.residual, self._norm = f.duplicate(), f.norm()
        self.measure()

    def measure(self) -> float:
        """Compute the residual f + A d; return its norm relative to that of f. Collective."""
        self.A.mult(self.d, self.residual)
        self.residual.axpy(1.0, self.f)
        norm = self.residual.norm() if isfinite(self.d.norm()) else inf
        self.relative = norm / self._norm if self._norm > 0 else 0.0
        return self.relative

    def restore(self, previous: PETSc.Vec) -> None:
        """Take an earlier solution back. Collective."""
        previous.copy(self.d)
        self.measure()

    def attainable(self, rtol: float) -> float:
        """Return ``rtol``, or the relative residual that rounding permits if it is larger."""
        if not self._norm > 0 or not isfinite(self.relative):
            return rtol
        size = self.P.norm(PETSc.NormType.INFINITY) * self.d.norm() / self._norm
        return max(rtol, min(_ROUNDING * size, _LARGEST_ROUNDING))

    def factorise(self, step: Step) -> bool:
        """Replace the solution by one with sparse factors if it is better; return whether it is.

        The iterations, and whether memory sufficed, are added to ``step``. Collective.
        """
        ksp, iterated, before = PETSc.KSP().create(self.d.comm), self.d.copy(), self.relative
        try:
            ksp.setOperators(self.A, self.P)
            ksp.setType(PETSc.KSP.Type.FGMRES)
            ksp.setTolerances(rtol=_ROUNDING, atol=0.0, max_it=_FACTORS_MAX_IT)
            set_direct_factors(ksp.getPC())
            self.d.set(0.0)
            ksp.solve(self.f, self.d)
            self.d.scale(-1.0)
            step.linear += ksp.getIterationNumber()
            step.out_of_memory = factors_out_of_memory(ksp.getPC())
        finally:
            ksp.destroy()
        if self.measure() < before:
            return True
        self.restore(iterated)
        return False


class SearchDirection:
    r"""Inexact solver of :math:`H d = -f`, with the Hessian that ``-snes_hessian`` names.

    ============  ==================================================================================
    ``exact``     never filtered; it fails where it gives no descent direction
    ``clamp``     negative eigenvalues become 0 at every quadrature point (Teran et al. 2005;
                  Smith et al. 2018)
    ``abs``       they become their absolute value (Chen et al. 2024)
    ``adaptive``  exact while the linear solver finds it positive definite; filtered
                  (``-snes_adaptive_filter``) when it does not, and from then on until the residual
                  has fallen to a tenth
    ============  ==================================================================================

    Parameters
    ----------
    newton : ProjectedNewton
        Assembles the matrices; it has the problem, the options and the linear solvers.
    snes : SNES
        The SNES whose context it is.
    forcing : ForcingTerm
        The relative tolerance of the linear solves.
    accurate : bool
        Whether the direction is used as it is: its residual must reach the tolerance of the linear
        solver, and the forcing term's target. Newton's iterations need no accuracy, as the
        nonlinear residual decides.

    Notes
    -----
    An inexact solution for a semidefinite matrix may be no descent direction (of a saddle-point
    problem's merit function, or by rounding). It is improved until it is one, and the
    linear solves of the further iterations have the smallest relative tolerance, ``-ksp_rtol``.
    """

    def __init__(
        self,
        newton: ProjectedNewton,
        snes: PETSc.SNES,
        forcing: ForcingTerm,
        accurate: bool = False,
    ) -> None:
        self.snes, self.assemble = snes, partial(newton.assemble, snes)
        self.line_search, self.forcing, self._accurate = newton.line_search(snes), forcing, accurate
        self._saddle_point, self._asymmetric = newton.problem.saddle_point, newton.asymmetric
        self._ksp = snes.getKSP()
        # A linear solver that the user chose is not replaced.
        choice, options = newton.linear_choice, newton.options
        self._factorise = bool(choice.reason) and not choice.direct
        self.hessian = str(options["snes_hessian"])
        self._fallback = str(options["snes_adaptive_filter"])
        #: Norm of the residual where the exact Hessian was last found indefinite [N].
        self._indefinite = float("inf")
        #: Whether the exact Hessian has been positive definite as a block of the preconditioner.
        self._exact_blocks = self._asymmetric is None

    def compute(self, start: State, d: PETSc.Vec) -> Step:
        """Set ``d`` to the search direction at ``start``. Collective.

        Returns
        -------
        Step
            Without an end; its slope is None if there is no descent direction.
        """
        norm, step = start.residual.norm(), Step()
        A, P = self.snes.getJacobian()[:2]
        own = self.snes.getKSP()
        blocks = preconditioner_by_blocks(own.getPC()) if self._saddle_point else None
        for step.filter, block_filter in self._attempts(norm, blocks):
            step.filtered_points = self.assemble(start.x, block_filter)
            if blocks is not None and self._saddle_point:
                self._saddle_point.update_schur_approximation(P)
            changed = step.filtered_points > 0 or self._asymmetric is not None
            unlike = step.filter != block_filter and changed
            if step.filter == "exact" and not step.filtered_points:
                step.filter = "none needed"
            exact = partial(self.assemble, start.x, "exact") if unlike else None
            asymmetric = self._asymmetric
            self._ksp = ksp = asymmetric.ksp if asymmetric and asymmetric.needed else own
            with frozen_preconditioner(ksp, A, P, exact) if blocks else nullcontext():
                step.slope = self._solve(A, P, start.residual, d, step)
            if step.slope is not None:
                if step.filter in ("exact", "none needed"):
                    step.negative = negative_pivots(ksp.getPC())
                return step
            self._indefinite = norm
        return step

    @property
    def _needs_asymmetric(self) -> bool:
        """Whether the last Hessian is not symmetric."""
        return self._asymmetric is not None and self._asymmetric.needed

    def _attempts(self, norm: float, blocks: Blocks | None) -> Iterator[tuple[str, str]]:
        """Yield the filters to try, in this order, at a residual of this norm.

        The first is that of the operator, the second that of the preconditioner's blocks, which
        must be positive definite. `BlockTriangular` finds out whether the exact Hessian is.
        """
        for filter in self._filters(norm):
            if blocks is not None and filter == "exact":
                if isinstance(blocks, BlockTriangular) and self._exact_blocks:
                    yield filter, filter
                    if not blocks.indefinite:
                        continue
                    self._exact_blocks = False
                yield filter, "clamp"
            else:
                yield filter, filter

    def accepts(self, start_norm: float, step: Step) -> bool:
        """Return whether to keep a step; if not, `compute` now gives the filtered direction.

        In a saddle-point problem an indefinite Hessian may give a descent direction of the merit
        function; only a short step along it, or none, shows it. ``start_norm`` is the residual's
        norm at the start.
        """
        usual = self._saddle_point is None and not self._needs_asymmetric
        if usual or step.length >= SHORT or step.limited:
            return True
        self._indefinite = start_norm
        return self.hessian != "adaptive" or step.filter != "exact"

    def _filters(self, norm: float) -> list[str]:
        """Return the filters to try, in this order, at a residual of this norm."""
        if self.hessian != "adaptive":
            return [self.hessian]
        exact = [] if norm > _RETRY * self._indefinite else ["exact"]
        return [*exact, self._fallback]

    def _solve(
        self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec, step: Step
    ) -> float | None:
        """Solve A d = -f; return the slope along d, or None if A showed negative curvature."""
        ksp, semidefinite = self._ksp, step.filter in ("clamp", "abs")
        filtered = semidefinite and self._saddle_point is None
        reason = self._apply(ksp, A, P, f, d, step)
        if reason in _INDEFINITE and filtered and ksp.getType() == PETSc.KSP.Type.PYTHON:
            # A filtered matrix is indefinite only by rounding in single precision, where crushed
            # cells are a million times as stiff as their neighbours.
            self._apply(self._double_precision, A, P, f, d, step)
        elif reason in _INDEFINITE and not semidefinite:
            return None
        elif reason == _Linear.DIVERGED_INDEFINITE_PC and filtered:
            return None  # of a preconditioner that the user chose: no refinement makes it better
        slope = self._slope(A, f, d, filtered)
        last = semidefinite or (self.hessian == "exact" and step.filter == "none needed")
        if self._accurate or (slope is None and last):
            return self._improved(A, P, f, d, step, filtered)
        return slope

    def _slope(self, A: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec, filtered: bool) -> float | None:
        """Return the slope along d, or None if it is no descent direction."""
        if filtered:
            slope = float(f.dot(d))  # the matrix is positive semidefinite
            return slope if slope < 0 else None
        Ad = f.duplicate()
        A.mult(d, Ad)
        return self.line_search.slope(f, d, Ad)

    def _improved(
        self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec, step: Step, filtered: bool
    ) -> float | None:
        """Improve the solution ``d`` until it is accurate, or descends; return the slope along it.

        Returns None if no solution is good enough.
        """
        rtol = given = self._ksp.getTolerances()[0]
        if self._accurate and (norm := f.norm()) > 0:
            rtol = min(rtol, self.forcing.target / norm)
        solution, slope = Solution(A, P, f, d), None
        first = solution.relative

        def is_accepted() -> bool:
            nonlocal slope
            slope = self._slope(A, f, d, filtered)
            if self._accurate:
                return solution.relative <= solution.attainable(rtol)
            return slope is not None

        accepted = is_accepted() or self._refine(solution, step, rtol, is_accepted)
        if not accepted and self._factorise and not self._needs_asymmetric:
            if solution.factorise(step):
                accepted = is_accepted()
                step.remedy = f"sparse factors, as iterations left {first:.2g} of the residual"
        step.residual = solution.relative
        if self._accurate and not solution.relative <= solution.attainable(rtol):
            limit = f"{rtol:.2g}" if rtol < given else f"ksp_rtol = {rtol:g}"
            step.lack = f"relative residual {solution.relative:.2g} > {limit}"
        if not self._accurate:
            self.forcing.maximum = min(self.forcing.maximum, rtol)
        return slope if accepted else None

    def _refine(
        self, solution: Solution, step: Step, rtol: float, is_accepted: Callable[[], bool]
    ) -> bool:
        """Refine a solution by the same solver until it is accepted; return whether it is."""
        A, P, d, correction = solution.A, solution.P, solution.d, solution.d.duplicate()
        while isfinite(solution.relative) and solution.relative > rtol:
            before, previous = solution.relative, d.copy()
            goal = min(max(_CYCLE_SHARE * rtol / before, _CYCLE_RTOL[0]), _CYCLE_RTOL[1])
            self._apply(self._ksp, A, P, solution.residual, correction, step, goal)
            d.axpy(1.0, correction)
            if not solution.measure() < before:
                solution.restore(previous)
                break
            if is_accepted():
                return True
            if solution.relative > _MIN_REDUCTION * before:
                break
        return False

    def _apply(
        self,
        ksp: PETSc.KSP,
        A: PETSc.Mat,
        P: PETSc.Mat,
        f: PETSc.Vec,
        d: PETSc.Vec,
        step: Step,
        rtol: float | None = None,
    ) -> int:
        """Set ``d`` to the solution of A d = -f by ``ksp``; return its converged reason.

        The relative tolerance is the forcing term unless ``rtol`` is given.
        """
        d.set(0.0)
        with self.forcing.applied(ksp) if rtol is None else relative_tolerance(ksp, rtol):
            set_operators(ksp, outer_operator(ksp, A, P), P)
            ksp.solve(f, d)
        d.scale(-1.0)
        step.linear += ksp.getIterationNumber()
        return int(ksp.getConvergedReason())

    @cached_property
    def _double_precision(self) -> PETSc.KSP:
        """Return PETSc's CG with Jacobi, with the tolerances of the SNES's linear solver."""
        linear_solver = self.snes.getKSP()
        ksp = PETSc.KSP().create(linear_solver.comm)
        ksp.setType(PETSc.KSP.Type.CG)
        ksp.getPC().setType(PETSc.PC.Type.JACOBI)
        rtol, atol, _, max_it = linear_solver.getTolerances()
        ksp.setTolerances(rtol=rtol, atol=atol, max_it=max_it)
        return ksp
