r"""SSOR-preconditioned conjugate gradients in single precision, refined iteratively in double.

Newton's linear systems need a relative tolerance of 1e-1 to 1e-2 only, and the time to solve them
is memory traffic: single precision halves it, but limits the reduction of the residual in one run
of conjugate gradients. For smaller tolerances the residual b - A x is computed in double precision
and a correction is solved for (iterative refinement, Wilkinson 1963): each run is a refinement
cycle. `fem_snh.linalg.deflation` solves for motions that single precision loses.

Let A = L + D + L^T with the block diagonal D. The preconditioner is block
SSOR (Saad 2003, sec. 4.1 and 10.2),

.. math::

    M = (D + L)\, D^{-1} (D + L)^T.

On several ranks, rows that couple to other ranks come first in the order of the sweeps if all these
ranks are higher ones, and last otherwise (Adams 2001). L has the couplings of last to first rows of
different ranks; M omits those of two last rows. Instead, a fraction of their absolute row sums is
added to D (Baker et al. 2011): errors that differ across the boundaries of ranks then converge as
fast as other errors. Preconditioned conjugate gradients (Saad 2003, alg. 9.1) are
written for :math:`\hat A = (D + L)^{-1} A\, (D + L)^{-T}` with the preconditioner :math:`D^{-1}`,
so z = D r (Eisenstat 1981). Because

.. math::

    \hat A\, p = t + (D + L)^{-1} (A - D - L)\, t, \qquad t = (D + L)^{-T} p,

an iteration is one backward and one forward substitution: the product with A costs nothing extra.
Half of a symmetric matrix in single precision is a fifth of the memory traffic of a product in
PETSc's AIJ format.

References
----------
Adams 2001, Proceedings of the ACM/IEEE Conference on Supercomputing.
Baker, Falgout, Kolev & Yang 2011, SIAM J. Sci. Comput. 33, 2864.
Eisenstat 1981, SIAM J. Sci. Stat. Comput. 2, 1.
Saad 2003, Iterative methods for sparse linear systems, 2nd ed.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from math import inf, isfinite, sqrt
from typing import TYPE_CHECKING, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import aij_blocks, nonzero_state
from fem_snh.arrays import Array
from fem_snh.errors import BadInput, on_every
from fem_snh.linalg.block_matrix import (
    LATE,
    Halo,
    SymmetricBlockMatrix,
    displacement_blocks,
    open_kernels,
    stored_in,
)
from fem_snh.linalg.half_matrix import HalfMatrix

if TYPE_CHECKING:
    from fem_snh.linalg.deflation import BodyModes, Deflation


_Reason = PETSc.KSP.ConvergedReason
#: Residual reduction per refinement cycle. Single precision rounds to 6e-8; the remaining factor of
#: 1000 is for the accumulated rounding errors of the iterations.
_CYCLE_REDUCTION = 1e-4
#: A cycle ends if its residual is this many times its least one. In single precision, deflation
#: leaves a component in the coarse space, which grows until a negative curvature seems to be zero.
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

    The matrix is an AIJ matrix, one of `fem_snh.linalg.block_matrix.part_of`, or that of a
    `fem_snh.linalg.half_matrix.HalfMatrix`, whose floats are used as they are.

    Tolerances, monitors and converged reasons are those of any KSP; the norm is the natural one,
    sqrt(r.M^-1 r). The KSP's PC is not used. With coordinates the iteration is deflated, see
    `fem_snh.linalg.deflation`; ``-ksp_deflation_subdomains`` sets the number of subdomains.

    Parameters
    ----------
    coordinates : (rows, dim), optional
        Reference coordinates of this rank's nodes; without them there is no deflation.

    Attributes
    ----------
    has_residual : bool
        Whether `residual` returns the residual of the last solution.

    Raises
    ------
    BadInput
        From `solve`, for a matrix whose blocks are neither 2x2 nor 3x3.

    Notes
    -----
    Beside those of PETSc's convergence test, the converged reasons are

    - CONVERGED_HAPPY_BREAKDOWN if the matrix turns out to be singular, and a refinement cycle does
      not reduce what is left of the residual,
    - DIVERGED_INDEFINITE_MAT at a direction of negative curvature,
    - DIVERGED_INDEFINITE_PC if a diagonal block is not positive definite or a sweep overflows,
    - DIVERGED_BREAKDOWN if a refinement cycle does not reduce the residual,
    - DIVERGED_NANORINF if the matrix is not finite.
    """

    def __init__(self, coordinates: np.ndarray | None = None) -> None:
        self._coordinates, self._subdomains = coordinates, AUTOMATIC
        self.has_residual = False

    def create(self, ksp: PETSc.KSP) -> None:
        """Set an empty state; PETSc calls this."""
        self._made: SSORSystem | None = None
        self._modes: BodyModes | None = None
        self._state = -1  # of the matrix last used

    def setFromOptions(self, ksp: PETSc.KSP) -> None:
        """Read ``ksp_deflation_subdomains``: 0 for no deflation, -1 for a number by the size."""
        options = PETSc.Options(ksp.getOptionsPrefix())
        self._subdomains = options.getInt("ksp_deflation_subdomains", AUTOMATIC)

    @property
    def _system(self) -> SSORSystem:
        assert self._made is not None, "before `update_matrix`"
        return self._made

    def update_matrix(self, A: PETSc.Mat) -> None:
        """Update the preconditioner, the copy of an AIJ matrix and the deflation space.

        Nothing is done if neither the matrix object nor its values changed. The sparsity pattern is
        read if it or the matrix object changed.
        """
        if self._made is None or not self._made.fits(A):
            self._made, self._state = SSORSystem(A, self._coordinates, self._subdomains), -1
        if self._state != A.stateGet():
            self._failure, self._state = self._system.update(A), A.stateGet()
            self._modes = None if self._failure else self._system.body_modes(A)

    def solve(self, ksp: PETSc.KSP, b: PETSc.Vec, x: PETSc.Vec) -> None:
        """Solve A x = b from x = 0, whatever ``x`` holds; PETSc calls this."""
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
        """Return this rank's b - A x of the last solution, to single precision. Collective.

        Valid only if `has_residual`.
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
        """Iterate (Saad 2003, alg. 9.1) until the KSP's test or the end of the cycle.

        Returns the number of iterations of the solve, ``its`` of them before the cycle, and whether
        the last direction is in the null space of A.
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


#: Default number of subdomains: one per 512 nodes up to 64 subdomains, then one per 1,000 nodes; no
#: deflation below 4 subdomains, where the coarse solves cost as much as the iterations saved
#: (docs/results/speed.md).
_NODES_PER_SUBDOMAIN, _MANY_SUBDOMAINS = 512, 64
_NODES_PER_SUBDOMAIN_OF_LARGE, _MIN_SUBDOMAINS = 1000, 4
#: In two dimensions, where coarse solves cost less: one subdomain per 64 nodes up to 16 subdomains,
#: then one per 256 nodes up to 64 (docs/results/linear_solver.md).
_NODES_OF_FEW, _FEW, _NODES_OF_MANY = 64, 16, 256
#: On more than this number of ranks twice as many subdomains, in three dimensions up to 100, as the
#: sweeps omit some couplings of ranks. More subdomains would save iterations, but cost more in
#: coarse solves (docs/results/scaling.md).
_FEW_RANKS, _MOST_ON_RANKS = 2, 100
#: Largest number of subdomains on several ranks, each of which repeats the coarse solves.
_MOST_REPEATED = 300
AUTOMATIC = -1
#: A curvature above -1e-6 p.D^-1 p counts as zero: the rounding error of a sum in single precision.
ZERO_CURVATURE = 1e-6
#: Components of a displacement: the sizes of blocks for which there are kernels.
BLOCK_SIZES = (2, 3)


#: Required accuracy of a rigid motion: the least tolerance of Newton's linear systems. Rounding to
#: eps leaves an error eps / q if its Rayleigh quotient is q times the largest diagonal entry.
_ACCURACY = 1e-3
_LEAST_IN_SINGLE, LEAST_IN_DOUBLE = (
    float(np.finfo(kind).eps) / _ACCURACY for kind in (np.float32, np.float64)
)


class CycleStart(NamedTuple):
    """The start of a refinement cycle.

    Attributes
    ----------
    norm : float
        The residual's natural norm, sqrt(r.M^-1 r).
    deflated_norm : float
        The natural norm of the deflated residual, P r.
    unit : float
        The factor from the scaled to the true solution: the vectors are scaled, so that single
        precision does not overflow.
    rho : float
        r.z of the scaled vectors.
    """

    norm: float
    deflated_norm: float
    unit: float
    rho: float


class SSORSystem:
    r"""A symmetric matrix, its preconditioner and the vectors of CG. Collective.

    The vectors are those of Saad's algorithm for :math:`\hat A`: x, r, z, p, q = A-hat p, and
    t = (D + L)^-T p, whose multiples add up to x.

    Parameters
    ----------
    A : PETSc.Mat
        A matrix of 2x2 or 3x3 blocks, as for `EisenstatCG`; its pattern is read here, its values by
        `update`.
    coordinates : (rows, dim) or None
        Reference coordinates of this rank's nodes; without them there is no deflation.
    subdomains : int
        Number of deflation subdomains, 0 for none, AUTOMATIC for a number by the matrix's size.
    separate : bool
        Whether the preconditioner must stay as it is when a half is assembled again.

    Attributes
    ----------
    matrix : SymmetricBlockMatrix
        The half of this rank's rows.
    halo : Halo or None
        Exchange of the ghost nodes; None on one rank.
    deflation : Deflation or None
        The deflation space, if there is one.
    scale : float
        The factor of its values.

    Raises
    ------
    BadInput
        On every rank, for a matrix whose blocks are neither 2x2 nor 3x3, without a diagonal block
        in every row, or with a pattern that is not symmetric.
    """

    def __init__(
        self,
        A: PETSc.Mat,
        coordinates: np.ndarray | None,
        subdomains: int = AUTOMATIC,
        separate: bool = False,
    ) -> None:
        block = A.getBlockSize()
        if block not in BLOCK_SIZES:
            raise BadInput(
                f"matrix block size = {block}: expected 2x2 or 3x3 blocks (a displacement) for "
                "the built-in linear solver"
            )
        self.comm, self.unknowns = A.comm.tompi4py(), A.getSize()[0]
        self._pattern, self._coordinates = _pattern(A), coordinates
        if half := _half_of(A):
            self.halo, blocks = half.halo, half.blocks
            self.matrix = half.matrix.separate() if separate else half.matrix
        else:
            library, blocks = open_kernels(self.comm, block), displacement_blocks(A)
            shared = blocks.off_diagonal is not None
            self.halo = Halo(self.comm, blocks.first, blocks.ghosts, block) if shared else None
            given = library, block, blocks, self.halo
            self.matrix = on_every(self.comm, SymmetricBlockMatrix, *given)
        self._total = np.zeros(1)
        self.deflation: Deflation | None = None
        if subdomains == AUTOMATIC and coordinates is not None:
            nodes, dim = self.unknowns // block, coordinates.shape[1]
            subdomains = _default_subdomains(nodes, self.comm.size, dim)
        if coordinates is not None and subdomains > 0:
            from fem_snh.linalg.deflation import Deflation

            self.deflation = Deflation(
                self.comm, self.matrix, blocks, self.halo, coordinates, subdomains
            )
        size = block * self.matrix.rows
        self._vectors: dict[str, Array] = {key: np.zeros(size, np.float32) for key in "xrzptwq"}
        self._x, self._r, self._t = (self._vectors[key] for key in "xrt")
        self._pointers = {key: self.matrix.pointer(v) for key, v in self._vectors.items()}

    def fits(self, A: PETSc.Mat) -> bool:
        """Return whether ``A`` is the matrix given at construction, with the same pattern."""
        return self._pattern == _pattern(A)

    def update(self, A: PETSc.Mat) -> int:
        """Copy the values of A, if AIJ, scaled to a largest diagonal entry of 1; update the rest.

        Returns
        -------
        int
            0, or a negative ``KSP.ConvergedReason`` if the matrix is not finite or indefinite.
        """
        with _values(A) as values:
            largest = self.matrix.largest_diagonal_entry(values[0])
            largest = self.comm.allreduce(largest, op=MPI.MAX)
            if not isfinite(largest):
                return int(_Reason.DIVERGED_NANORINF)
            half = _half_of(A)
            if half and self.matrix is not half.matrix:
                self.matrix.copy_floats(half.matrix)
            self.scale = half.scale if half else 1 / largest if largest > 0 else 1.0
            self.matrix.struct.largest = (largest or 1.0) if half else 1.0
            if self.comm.allreduce(self.matrix.fill(*values, self.scale)):
                return int(_Reason.DIVERGED_INDEFINITE_PC)
            return self.deflation.update(*values, self.scale) if self.deflation else 0

    def body_modes(self, A: PETSc.Mat) -> BodyModes | None:
        """Return the `BodyModes` of A; None if single precision suffices. Collective."""
        X, matrix = self._coordinates, self.matrix
        if X is None:
            return None
        energies = self.comm.allreduce(matrix.translations)
        least = energies.min() * matrix.size / self.unknowns  # of the Rayleigh quotients
        if not LEAST_IN_DOUBLE < least / matrix.struct.largest < _LEAST_IN_SINGLE:
            return None
        from fem_snh.linalg.deflation import BodyModes

        with _values(A) as values:
            free = matrix.coupled_unknowns(*values)
        return BodyModes(A, X, free, self.scale / matrix.struct.largest)

    def start_cycle(self, residual: PETSc.Vec) -> CycleStart:
        """Start CG at x = 0 for the right-hand side ``residual``, which deflation projects."""
        size = residual.norm(PETSc.NormType.INFINITY)
        self._size = size = size if isfinite(size) and size > 0 else 1.0
        v = self._pointers
        self._r[:] = residual.array_r / size
        for key in "xptq":
            self._vectors[key][:] = 0
        if self.deflation:
            self._vectors["z"][:] = self._r
            self.deflation.start(v["r"])
            both = self._r, self._vectors["z"]
            whole = self._sum(self.matrix.sweep("matrix_solve_lower_both", both, v["r"], v["z"]))
            rho = self.update_vectors(0.0)
        else:
            self.matrix.sweep("matrix_solve_lower", [self._r], v["r"])
            whole = rho = self.update_vectors(0.0)
        norm, deflated = (size * sqrt(self.scale * max(square, 0.0)) for square in (whole, rho))
        return CycleStart(norm, deflated, size * self.scale, rho)

    def update_direction(self, beta: float) -> float:
        """Compute p = z + beta p and q = A-hat p (deflated); return the curvature p.q = t.A t."""
        matrix, v = self.matrix, self._pointers
        backward = beta, *(v[key] for key in "zptw")
        matrix.sweep("matrix_backward_sweep", [self._t], *backward, first=LATE)
        if self.deflation:
            self.deflation.project(v["t"], v["w"])
        forward = (v[key] for key in "ptwq")
        return self._sum(matrix.sweep("matrix_forward_sweep", [self._vectors["q"]], *forward))

    def update_vectors(self, alpha: float) -> float:
        """Compute x += alpha t, r -= alpha q and z = D r; return r.z."""
        matrix, v = self.matrix, self._pointers
        arguments = alpha, v["t"], v["q"], v["x"], v["r"], v["z"]
        return self._sum(matrix.lib.matrix_cg_update(matrix.struct, *arguments))

    def residual(self) -> Array:
        """Return this rank's b - A x, (size rows,), to single precision. Collective."""
        matrix, r = self.matrix, np.empty(len(self._r))
        pointers = self._pointers["r"], self._size, matrix.pointer(r)
        matrix.sweep("matrix_multiply_lower", [self._r], *pointers)
        return r

    def precondition(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = M^-1 x, scaled so that single precision does not overflow."""
        size = x.norm(PETSc.NormType.INFINITY)
        size = size if isfinite(size) and size > 0 else 1.0
        matrix, v = self.matrix, self._pointers
        self._r[:] = x.array_r / size
        self._vectors["p"][:] = 0
        matrix.sweep("matrix_solve_lower", [self._r], v["r"])
        matrix.lib.matrix_cg_update(matrix.struct, 0.0, *(v[key] for key in "tqxrz"))  # z = D r
        backward = 0.0, *(v[key] for key in "zptw")
        matrix.sweep("matrix_backward_sweep", [self._t], *backward, first=LATE)
        y.array[:] = np.multiply(self._t, size * self.scale, dtype=np.float64)

    def direction_norm_squared(self) -> float:
        """Return p.D^-1 p over all ranks."""
        matrix, p = self.matrix, self._pointers["p"]
        return self._sum(matrix.lib.matrix_weighted_norm(matrix.struct, p))

    def add_solution(self, x: PETSc.Vec, unit: float) -> None:
        """Add the cycle's solution, times ``unit``, to x in double precision."""
        if self.deflation:
            self.deflation.finish(self._pointers["x"])
        # A float32 array times a float is float32, in which forces of 1e40 overflow.
        x.array[:] += np.multiply(self._x, unit, dtype=np.float64)

    def _sum(self, own: float) -> float:
        """Return the sum of ``own`` over all ranks."""
        if self.comm.size == 1:
            return own
        self._total[0] = own  # a buffer: MPI's own sum, not messages of Python objects
        self.comm.Allreduce(MPI.IN_PLACE, self._total)
        return float(self._total[0])


def _half_of(A: PETSc.Mat) -> HalfMatrix | None:
    """Return the `HalfMatrix` of a matrix; None for another one."""
    context = A.getPythonContext() if A.getType() == PETSc.Mat.Type.PYTHON else None
    return context if isinstance(context, HalfMatrix) else None


@contextmanager
def _values(A: PETSc.Mat) -> Iterator[tuple[int, int]]:
    """Yield the addresses of the values of an AIJ matrix; 0 where there are none."""
    if _half_of(A):
        yield 0, 0
        return
    with aij_blocks(stored_in(A), read_only=True) as (diagonal, *off_diagonal):
        yield diagonal.values, off_diagonal[0].values if off_diagonal else 0


def _pattern(A: PETSc.Mat) -> tuple[int, tuple[int, int]]:
    """Return numbers that identify a matrix object and its sparsity pattern."""
    return A.handle, nonzero_state(stored_in(A))


def _default_subdomains(nodes: int, ranks: int, dim: int) -> int:
    """Return the number of deflation subdomains for ``nodes`` on all ranks, 0 for none."""
    many = ranks > _FEW_RANKS
    subdomains, most = nodes // _NODES_PER_SUBDOMAIN, _MANY_SUBDOMAINS
    if dim == 2:
        few = min(nodes // _NODES_OF_FEW, _FEW)
        subdomains = max(few, min(nodes // _NODES_OF_MANY, most))
    elif many:
        most = _MOST_ON_RANKS
    if subdomains < _MIN_SUBDOMAINS:
        return 0
    subdomains = min(subdomains * (2 if many else 1), most)
    of_large = nodes // _NODES_PER_SUBDOMAIN_OF_LARGE
    return max(subdomains, of_large if ranks == 1 else min(of_large, _MOST_REPEATED))


class SSOR:
    r"""A PC of type "python" for a symmetric matrix of 2x2 or 3x3 blocks. Collective.

    .. math:: M = (D + L)\, D^{-1} (D + L)^T

    D and L are those of `SSORSystem`. A product with :math:`M^{-1}` is a forward and a
    backward substitution in single precision, which read a third of what incomplete factors read.
    M is symmetric to single precision, and positive definite if the blocks of D are.
    """

    def create(self, pc: PETSc.PC) -> None:
        """Set an empty state; PETSc calls this."""
        self._system: SSORSystem | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Copy the matrix; PETSc calls this where its values have changed."""
        P = pc.getOperators()[1]
        if self._system is None or not self._system.fits(P):
            self._system = SSORSystem(P, None, separate=True)
        self._failed = bool(self._system.update(P))

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = M^-1 x; infinite values tell the KSP that M is not finite or indefinite."""
        assert self._system is not None, "before `setUp`"
        if self._failed:
            y.set(inf)
        else:
            self._system.precondition(x, y)
