r"""The SSOR-preconditioned system in single precision: matrix, vectors, steps of an iteration.

On each rank's rows let A = L + D + L^T with the block diagonal D. The preconditioner is block
SSOR (Saad 2003, sec. 4.1 and 10.2),

.. math::

    M = (D + L)\, D^{-1} (D + L)^T.

On several ranks D also has a part of the absolute row sums of what couples the rank's rows to other
ranks, which M does not contain otherwise (Baker et al. 2011): errors that differ across the ends of
a rank then converge as fast as others. Preconditioned conjugate gradients (Saad 2003, alg. 9.1) are
written for :math:`\hat A = (D + L)^{-1} A\, (D + L)^{-T}`, preconditioned by :math:`D^{-1}`
(Eisenstat 1981).
Because

.. math::

    \hat A\, p = t + (D + L)^{-1} (A - D - L)\, t, \qquad t = (D + L)^{-T} p,

an iteration is one backward and one forward substitution: the product with A costs nothing extra.
Half of a symmetric matrix in single precision is a fifth of the memory traffic of a product in
PETSc's AIJ format.

References
----------
Baker, Falgout, Kolev & Yang 2011, SIAM J. Sci. Comput. 33, 2864.
Eisenstat 1981, SIAM J. Sci. Stat. Comput. 2, 1.
Saad 2003, Iterative methods for sparse linear systems, 2nd ed.
"""

from __future__ import annotations

from math import inf, isfinite, sqrt
from typing import TYPE_CHECKING, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import aij_blocks, nonzero_state
from fem_snh.errors import BadInput, on_every
from fem_snh.linalg.block_matrix import SymmetricBlockMatrix, open_kernels
from fem_snh.linalg.coarse_matrix import MAX_INVERTED
from fem_snh.linalg.halo import Halo
from fem_snh.linalg.matrix_parts import displacement_blocks, stored_in

if TYPE_CHECKING:
    from fem_snh.linalg.deflation import BodyModes, Deflation

_Reason = PETSc.KSP.ConvergedReason

#: Default of ksp_deflation_subdomains: one for 512 nodes up to 64, then one for 1,000 nodes, and no
#: deflation below 4 (docs/results/speed.md). On smaller bodies the coarse solves cost as much as
#: the iterations saved.
_NODES_PER_SUBDOMAIN, _NODES_PER_SUBDOMAIN_OF_LARGE, _MIN_SUBDOMAINS = 512, 1000, 4
#: In two dimensions coarse solves cost less, and few nodes have the bandwidth of many: at least one
#: for 64 nodes up to 16, then one for 256 up to 64 (docs/results/linear_solver.md).
_NODES_OF_FEW, _FEW, _NODES_OF_MANY = 64, 16, 256
#: On more ranks than this twice as many, in three dimensions up to 100: the sweeps of a rank leave
#: out what couples it to others. More would save iterations, whose coarse solves cost more
#: (docs/results/scaling.md).
_FEW_RANKS, _MOST_ON_RANKS = 2, 100
AUTOMATIC = -1
#: A curvature above -1e-6 p.D^-1 p counts as zero: the rounding error of a sum in single precision.
ZERO_CURVATURE = 1e-6
#: Default of ksp_deflation_replicated.
MAX_REPLICATED = 300
#: Components of a displacement: the sizes of blocks for which there are kernels.
BLOCK_SIZES = (2, 3)


#: Accuracy asked for of a rigid motion: the least tolerance of Newton's linear systems. Rounding to
#: eps gives a motion of Rayleigh quotient q, in largest diagonal entries, to eps / q.
_ACCURACY = 1e-3
_LEAST_IN_SINGLE, LEAST_IN_DOUBLE = (
    float(np.finfo(kind).eps) / _ACCURACY for kind in (np.float32, np.float64)
)


class CycleStart(NamedTuple):
    """How a run of conjugate gradients starts.

    Attributes
    ----------
    norm : float
        The residual's natural norm, sqrt(r.M^-1 r).
    deflated_norm : float
        That of the deflated residual, P r.
    unit : float
        The factor of the solution: the vectors are scaled, so that single precision does not
        overflow.
    rho : float
        r.z of the scaled vectors.
    """

    norm: float
    deflated_norm: float
    unit: float
    rho: float


class SSORSystem:
    r"""A symmetric AIJ matrix, its preconditioner and the vectors of CG. Collective.

    The vectors are those of Saad's algorithm for :math:`\hat A`: x, r, z, p, q = A-hat p, and
    t = (D + L)^-T p, whose multiples add up to x.

    Parameters
    ----------
    A : PETSc.Mat
        A matrix of 2x2 or 3x3 blocks, or one of `fem_snh.linalg.matrix_parts.part_of`; its pattern
        is read here, its values by `update`.
    coordinates : (rows, dim) or None
        Reference coordinates of this rank's nodes; without them there is no deflation.
    subdomains : int
        Number of deflation subdomains, 0 for none, AUTOMATIC for a number by the matrix's size.
    replicated : int
        Up to so many of them every rank holds their matrix; of more, only its rows.

    Attributes
    ----------
    matrix : SymmetricBlockMatrix
        The copy of this rank's rows.
    halo : Halo or None
        Exchange of the ghost nodes; None on one rank.
    deflation : Deflation or None
        The deflation space, if there is one.
    scale : float
        The factor of the copy's values.

    Raises
    ------
    BadInput
        On every rank, for a matrix whose blocks are neither 2x2 nor 3x3, or miss on one rank's
        diagonal.
    """

    def __init__(
        self,
        A: PETSc.Mat,
        coordinates: np.ndarray | None,
        subdomains: int = AUTOMATIC,
        replicated: int = MAX_REPLICATED,
    ) -> None:
        block = A.getBlockSize()
        if block not in BLOCK_SIZES:
            raise BadInput(
                f"matrix block size = {block}: expected 2x2 or 3x3 blocks (a displacement) for "
                "the built-in linear solver"
            )
        self.comm, self.unknowns = A.comm.tompi4py(), A.getSize()[0]
        self._pattern, self._coordinates = _pattern(A), coordinates
        library = open_kernels(self.comm, block)
        blocks = displacement_blocks(A)
        self.matrix = on_every(self.comm, SymmetricBlockMatrix, library, block, blocks)
        shared = blocks.off_diagonal is not None
        self.halo = Halo(self.comm, blocks.first, blocks.ghosts, block) if shared else None
        self._total = np.zeros(1)
        self.deflation: Deflation | None = None
        if subdomains == AUTOMATIC and coordinates is not None:
            nodes, dim = self.unknowns // block, coordinates.shape[1]
            subdomains = _default_subdomains(nodes, self.comm.size, dim)
        if coordinates is not None and subdomains > 0:
            from fem_snh.linalg.deflation import Deflation

            self.deflation = Deflation(
                self.comm, self.matrix, blocks, self.halo, coordinates, subdomains, replicated
            )
        size = block * self.matrix.rows
        self._vectors: dict[str, npt.NDArray[np.float32]] = {
            key: np.zeros(size, np.float32) for key in "xrzptwq"
        }
        self._x, self._r, self._t = (self._vectors[key] for key in "xrt")
        self._vectors["ghosts"] = self.halo.ghosts if self.halo else self._x
        self._pointers = {key: self.matrix.pointer(v) for key, v in self._vectors.items()}

    def fits(self, A: PETSc.Mat) -> bool:
        """Return whether ``A`` is the matrix given at construction, with the same pattern."""
        return self._pattern == _pattern(A)

    def update(self, A: PETSc.Mat) -> int:
        """Copy the values of the matrix, scaled to a largest diagonal entry of 1, and deflate.

        Returns
        -------
        int
            0, or a negative ``KSP.ConvergedReason`` if the matrix is not finite or indefinite.
        """
        with aij_blocks(stored_in(A), read_only=True) as (diagonal, *off_diagonal):
            largest = self.matrix.largest_diagonal_entry(diagonal.values)
            largest = self.comm.allreduce(largest, op=MPI.MAX)
            if not isfinite(largest):
                return int(_Reason.DIVERGED_NANORINF)
            self.scale = 1 / largest if largest > 0 else 1.0
            values = diagonal.values, off_diagonal[0].values if off_diagonal else 0
            if self.comm.allreduce(self.matrix.fill(*values, self.scale)):
                return int(_Reason.DIVERGED_INDEFINITE_PC)
            return self.deflation.update(*values, self.scale) if self.deflation else 0

    def body_modes(self, A: PETSc.Mat) -> BodyModes | None:
        """Return the body's modes, which the copy of A has lost, or None. Collective."""
        X, matrix = self._coordinates, self.matrix
        if X is None or not _is_almost_free(A, matrix.size, self.scale):
            return None
        from fem_snh.linalg.deflation import BodyModes

        with aij_blocks(stored_in(A), read_only=True) as (diagonal, *off_diagonal):
            values = diagonal.values, off_diagonal[0].values if off_diagonal else 0
            free = matrix.coupled_unknowns(*values)
        return BodyModes(A, X, free, self.scale)

    def start_cycle(self, residual: PETSc.Vec) -> CycleStart:
        """Start conjugate gradients for a residual from x = 0, or from the coarse component."""
        size = residual.norm(PETSc.NormType.INFINITY)
        self._size = size = size if isfinite(size) and size > 0 else 1.0
        lib, struct, v = self.matrix.lib, self.matrix.struct, self._pointers
        self._r[:] = residual.array_r / size
        for key in "xptq":
            self._vectors[key][:] = 0
        if self.deflation:
            self._vectors["z"][:] = self._r
            self.deflation.start(v["r"])
            whole = self._sum(lib.matrix_solve_lower_both(struct, v["r"], v["z"]))
            rho = self.update_vectors(0.0)
        else:
            lib.matrix_solve_lower(struct, v["r"])
            whole = rho = self.update_vectors(0.0)
        norm, deflated = (size * sqrt(self.scale * max(square, 0.0)) for square in (whole, rho))
        return CycleStart(norm, deflated, size * self.scale, rho)

    def update_direction(self, beta: float) -> float:
        """Compute p = z + beta p and q = A-hat p (deflated); return the curvature p.q = t.A t."""
        matrix, v = self.matrix, self._pointers
        matrix.lib.matrix_backward_sweep(matrix.struct, beta, v["z"], v["p"], v["t"], v["w"])
        if self.halo:
            self.halo.exchange(self._t)
        if self.deflation:
            self.deflation.project(v["t"], v["w"])
        arguments = v["p"], v["t"], v["ghosts"], v["w"], v["q"]
        return self._sum(matrix.lib.matrix_forward_sweep(matrix.struct, *arguments))

    def update_vectors(self, alpha: float) -> float:
        """Compute x += alpha t, r -= alpha q and z = D r; return r.z."""
        matrix, v = self.matrix, self._pointers
        arguments = alpha, v["t"], v["q"], v["x"], v["r"], v["z"]
        return self._sum(matrix.lib.matrix_cg_update(matrix.struct, *arguments))

    def residual(self) -> npt.NDArray[np.float64]:
        """Return this rank's residual b - A x of the present x, to single precision."""
        matrix, r = self.matrix, np.empty(len(self._r))
        pointers = self._pointers["r"], self._size, matrix.pointer(r)
        matrix.lib.matrix_multiply_lower(matrix.struct, *pointers)
        return r

    def precondition(self, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = M^-1 x, scaled so that single precision does not overflow."""
        size = x.norm(PETSc.NormType.INFINITY)
        size = size if isfinite(size) and size > 0 else 1.0
        matrix, v = self.matrix, self._pointers
        self._r[:] = x.array_r / size
        self._vectors["p"][:] = 0
        matrix.lib.matrix_solve_lower(matrix.struct, v["r"])
        matrix.lib.matrix_cg_update(matrix.struct, 0.0, *(v[key] for key in "tqxrz"))  # z = D r
        matrix.lib.matrix_backward_sweep(matrix.struct, 0.0, v["z"], v["p"], v["t"], v["w"])
        y.array[:] = np.multiply(self._t, size * self.scale, dtype=np.float64)

    def direction_norm_squared(self) -> float:
        """Return p.D^-1 p."""
        return self._sum(self.matrix.weighted_norm_squared(self._vectors["p"]))

    def add_solution(self, x: PETSc.Vec, unit: float) -> None:
        """Add the cycle's solution, times ``unit``, to x in double precision."""
        if self.deflation:
            self.deflation.finish(self._pointers["x"])
        # A float32 array times a float is float32, in which forces of 1e40 overflow.
        x.array[:] += np.multiply(self._x, unit, dtype=np.float64)

    def _sum(self, own: float) -> float:
        """Return the sum over all ranks."""
        if self.comm.size == 1:
            return own
        self._total[0] = own  # a buffer: MPI's own sum, not messages of Python objects
        self.comm.Allreduce(MPI.IN_PLACE, self._total)
        return float(self._total[0])


def _is_almost_free(A: PETSc.Mat, components: int, scale: float) -> bool:
    """Return whether single precision loses a translation of the whole body. Collective.

    ``scale`` is one over the largest diagonal entry of A, whose blocks have so many ``components``.
    """
    x, y = A.createVecs()
    quotients = []
    for component in range(components):
        x.set(0.0)
        x.array[component::components] = 1.0
        A.mult(x, y)
        quotients.append(scale * x.dot(y) / x.dot(x))
    for vector in (x, y):
        vector.destroy()
    return LEAST_IN_DOUBLE < min(quotients) < _LEAST_IN_SINGLE


def _pattern(A: PETSc.Mat) -> tuple[int, tuple[int, int]]:
    """Return numbers that tell a matrix and its pattern from others."""
    return A.handle, nonzero_state(stored_in(A))


def _default_subdomains(nodes: int, ranks: int, dim: int) -> int:
    """Return the number of deflation subdomains of a body with so many nodes, 0 for none."""
    many = ranks > _FEW_RANKS
    subdomains, most = nodes // _NODES_PER_SUBDOMAIN, MAX_INVERTED
    if dim == 2:
        few = min(nodes // _NODES_OF_FEW, _FEW)
        subdomains = max(few, min(nodes // _NODES_OF_MANY, most))
    elif many:
        most = _MOST_ON_RANKS
    if subdomains < _MIN_SUBDOMAINS:
        return 0
    subdomains = min(subdomains * (2 if many else 1), most)
    return max(subdomains, nodes // _NODES_PER_SUBDOMAIN_OF_LARGE)


class SSOR:
    r"""A PC of type "python" for a symmetric AIJ matrix of 2x2 or 3x3 blocks. Collective.

    .. math:: M = (D + L)\, D^{-1} (D + L)^T \text{ on each rank's rows}

    D and L are those of `SSORSystem`. A product with :math:`M^{-1}` is a forward and a
    backward substitution in single precision, which read a third of what incomplete factors do.
    M is symmetric to single precision, and positive definite if the blocks of D are.
    """

    def create(self, pc: PETSc.PC) -> None:
        """Set an empty state; PETSc calls this."""
        self._system: SSORSystem | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Copy the matrix; PETSc calls this where its values have changed."""
        P = pc.getOperators()[1]
        if self._system is None or not self._system.fits(P):
            self._system = SSORSystem(P, None)
        self._failed = bool(self._system.update(P))

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = M^-1 x; infinite values tell the KSP that M is not finite or indefinite."""
        assert self._system is not None, "before `setUp`"
        if self._failed:
            y.set(inf)
        else:
            self._system.precondition(x, y)
