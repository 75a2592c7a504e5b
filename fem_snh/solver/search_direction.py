r"""Compute Newton's search directions: assemble a filtered Hessian, solve the system inexactly.

`LineSearchNewton` and `solve_linearised` call `SearchDirection.compute`.

A Krylov solver estimates its residual in a norm of its own and by a recurrence. With rounding in
single precision, a preconditioner far from the matrix, or a breakdown, the estimate may be small
while the residual :math:`f + A d` is not. `Solution` computes this residual in double precision. An
inaccurate solution is first refined with the same solver (iterative refinement, Wilkinson 1963). If
that fails, flexible GMRES with sparse factors as its preconditioner solves the system.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import nullcontext
from functools import cached_property, partial
from math import inf, isfinite
from typing import TYPE_CHECKING

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import (
    NEGATIVE_CURVATURE,
    as_aij,
    factors_out_of_memory,
    jacobi_cg,
    negative_pivots,
    set_operators,
)
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

#: A refinement cycle that leaves more than this fraction of the residual is the last one.
_MIN_REDUCTION = 0.5
#: Bounds of a refinement cycle's relative tolerance, and its target as a fraction of the required
#: residual, as the solver's norm is not the 2-norm.
_CYCLE_RTOL, _CYCLE_SHARE = (1e-4, 0.1), 0.25
#: Iterations with sparse factors: one in exact arithmetic, another for each matrix of rank one that
#: the factors leave out, and a few for rounding errors.
_FACTORS_MAX_IT = 20
#: Rounding errors of f + A d relative to ||A|| ||d||, a few units in the last place.
_ROUNDING = 8 * float(np.finfo(float).eps)
#: Upper bound of the relative residual that counts as rounding, however large ||A|| ||d|| is.
_LARGEST_ROUNDING = 1e-3

#: The exact Hessian is tried again once the residual has fallen to this fraction of its norm where
#: the Hessian was indefinite (measured: python -m benchmarks negative_curvature).
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
    A : Mat
        The operator.
    P : Mat
        The assembled matrix: A, or A without its matrices of rank one.
    f : Vec
        The negative right-hand side.
    d : Vec
        The solution, which the methods change in place.

    Attributes
    ----------
    residual : Vec
        f + A d, of the last `update_residual`.
    relative : float
        ``|f + A d|_2 / |f|_2``; infinity if d is not finite, 0 if f = 0.
    """

    def __init__(self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec) -> None:
        self.A, self.P, self.f, self.d = A, P, f, d
        self.residual, self._norm = f.duplicate(), f.norm()
        self.update_residual()

    def update_residual(self) -> float:
        """Set `residual` and `relative` from the present ``d``; return `relative`. Collective."""
        self.A.mult(self.d, self.residual)
        self.residual.axpy(1.0, self.f)
        norm = self.residual.norm() if isfinite(self.d.norm()) else inf
        self.relative = norm / self._norm if self._norm > 0 else 0.0
        return self.relative

    def restore(self, previous: PETSc.Vec) -> None:
        """Copy an earlier solution into ``d`` and measure its residual. Collective."""
        previous.copy(self.d)
        self.update_residual()

    def attainable(self, rtol: float) -> float:
        """Return the larger of ``rtol`` and the relative residual that rounding may leave."""
        if not self._norm > 0 or not isfinite(self.relative):
            return rtol
        size = self.P.norm(PETSc.NormType.INFINITY) * self.d.norm() / self._norm
        return max(rtol, min(_ROUNDING * size, _LARGEST_ROUNDING))

    def factorise(self, step: Step) -> bool:
        """Solve by FGMRES with sparse factors of P; return whether the residual is smaller.

        If not, the former solution is restored. Updates ``step.linear`` and ``step.out_of_memory``.
        Collective.
        """
        ksp, iterated, before = PETSc.KSP().create(self.d.comm), self.d.copy(), self.relative
        try:
            ksp.setOperators(self.A, as_aij(self.P))
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
        if self.update_residual() < before:
            return True
        self.restore(iterated)
        return False


class SearchDirection:
    r"""Inexact solver of :math:`H d = -f`, with the Hessian that ``-snes_hessian`` names.

    ============  ==================================================================================
    ``exact``     never filtered; the step fails where there is no descent direction
    ``clamp``     negative eigenvalues become 0 at every quadrature point (Teran et al. 2005;
                  Smith et al. 2018)
    ``abs``       negative eigenvalues become their absolute value (Chen et al. 2024)
    ``adaptive``  exact while the linear solver finds the Hessian positive definite; otherwise
                  filtered (``-snes_adaptive_filter``), until the residual has fallen to a tenth
    ============  ==================================================================================

    Parameters
    ----------
    newton : ProjectedNewton
        Assembles the matrices, and holds the problem, the options and the linear solvers.
    snes : SNES
        The SNES whose context is ``newton``.
    forcing : ForcingTerm
        The relative tolerance of the linear solves.
    accurate : bool
        Whether the linear system's residual must reach both the relative tolerance of the linear
        solver and the forcing term's target [N]. Newton iterations do not need this, as later
        iterations correct errors.

    Notes
    -----
    An inexact solution for a semidefinite matrix may be no descent direction, by rounding or for
    the merit function of a saddle-point problem. The solution is then improved until it is one, and
    later iterations solve to the smallest relative tolerance, ``-ksp_rtol``.
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
            Without an end; its slope is None if no descent direction is found.
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
        """Yield the filters to try, in order: pairs of the operator's and the preconditioner's.

        ``norm`` is the norm of the residual [N]. ``blocks`` must be positive definite: they are
        made of the exact Hessian only until `BlockTriangular` finds it indefinite.
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
        """Return whether to keep a step; if not, the next `compute` filters the Hessian.

        In a saddle-point problem, or without symmetry, an indefinite Hessian may give a descent
        direction; only a step shorter than `SHORT`, or none, reveals this. ``start_norm`` is the
        residual's norm at the start [N].
        """
        usual = self._saddle_point is None and not self._needs_asymmetric
        if usual or step.length >= SHORT or step.at_largest_step:
            return True
        self._indefinite = start_norm
        return self.hessian != "adaptive" or step.filter != "exact"

    def _filters(self, norm: float) -> list[str]:
        """Return the operator's filters to try, in order, at a residual of this norm [N]."""
        if self.hessian != "adaptive":
            return [self.hessian]
        exact = [] if norm > _RETRY * self._indefinite else ["exact"]
        return [*exact, self._fallback]

    def _solve(
        self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec, step: Step
    ) -> float | None:
        """Set ``d`` to a solution of A d = -f; return the slope along d, None without descent."""
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
        """Return the merit function's slope along ``d``; None if ``d`` is no descent direction."""
        if filtered:
            slope = float(f.dot(d))  # the matrix is positive semidefinite
            return slope if slope < 0 else None
        Ad = f.duplicate()
        A.mult(d, Ad)
        return self.line_search.slope(f, d, Ad)

    def _improved(
        self, A: PETSc.Mat, P: PETSc.Mat, f: PETSc.Vec, d: PETSc.Vec, step: Step, filtered: bool
    ) -> float | None:
        """Improve ``d`` until it is accurate or a descent direction; return the slope along ``d``.

        Returns None if neither refinement nor sparse factors suffice. Updates ``step``, and lowers
        the forcing term's maximum.
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
                step.replacement = f"sparse factors, as iterations left {first:.2g} of the residual"
        step.residual = solution.relative
        if self._accurate and not solution.relative <= solution.attainable(rtol):
            limit = f"{rtol:.2g}" if rtol < given else f"ksp_rtol = {rtol:g}"
            step.inaccuracy = f"relative residual {solution.relative:.2g} > {limit}"
        if not self._accurate:
            self.forcing.maximum = min(self.forcing.maximum, rtol)
        return slope if accepted else None

    def _refine(
        self, solution: Solution, step: Step, rtol: float, is_accepted: Callable[[], bool]
    ) -> bool:
        """Refine ``solution`` with the same solver until it is accepted; return whether it was."""
        A, P, d, correction = solution.A, solution.P, solution.d, solution.d.duplicate()
        while isfinite(solution.relative) and solution.relative > rtol:
            before, previous = solution.relative, d.copy()
            goal = min(max(_CYCLE_SHARE * rtol / before, _CYCLE_RTOL[0]), _CYCLE_RTOL[1])
            self._apply(self._ksp, A, P, solution.residual, correction, step, goal)
            d.axpy(1.0, correction)
            if not solution.update_residual() < before:
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
        """Set ``d`` to the solution of A d = -f by ``ksp``; return the KSP's converged reason.

        The relative tolerance is the forcing term unless ``rtol`` is given. Adds the iterations to
        ``step.linear``.
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
        rtol, atol, _, max_it = self.snes.getKSP().getTolerances()
        return jacobi_cg(self.snes.getKSP().comm, rtol=rtol, atol=atol, max_it=max_it)
