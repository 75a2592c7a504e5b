r"""The coarse matrix :math:`E = Z^T A Z` of the deflation, and its solves.

E has a dense block for each pair of subdomains that share a row of A Z. It is inverted where it is
small. The factors of a larger one are sparse: an inverse would take :math:`O(n^3)` operations, and
:math:`O(n^2)` in every iteration.

A rank holds the unknowns of all subdomains, or of its own and those next to them. A coarse vector
has the entries of each subdomain that the rank holds. `Replicated` is faster for
few subdomains: one sum over the ranks, and each rank solves for itself. `Distributed` needs no
memory for other ranks' subdomains, and exchanges with the neighbouring ranks alone.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.linalg.block_matrix import Halo
from fem_snh.linalg.direct_solver import set_direct_factors

Array = npt.NDArray[Any]


class Replicated:
    """Every rank holds all subdomains, the unknowns of the coarse matrix E. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks whose contributions are added up.
    subdomains : int
        Number of subdomains on all ranks.

    Attributes
    ----------
    comm : MPI.Intracomm
        The ranks that share E; each of them has the rows of other subdomains.
    held : (n,)
        Number, among all of them, of each subdomain that this rank holds.
    own : int
        How many of them, the first, are rows of E on this rank.
    """

    def __init__(self, comm: MPI.Intracomm, subdomains: int) -> None:
        self._ranks, self.comm = comm, MPI.COMM_SELF
        self.held: Array = np.arange(subdomains)
        self.own = subdomains

    def local(self, subdomain: Array) -> Array:
        """Return the positions in ``held`` of subdomains."""
        return subdomain

    def gather(self, blocks: Array) -> Array:
        """Return the blocks of the rows of E on this rank, from those that each rank computes."""
        counts, entries = self._ranks.allgather(len(blocks)), int(np.prod(blocks.shape[1:]))
        gathered = np.empty((sum(counts), *blocks.shape[1:]), blocks.dtype)
        self._ranks.Allgatherv(blocks, [gathered, [entries * count for count in counts]])
        return gathered

    def add(self, y: Array) -> None:
        """Replace the entries of the rows on this rank by the sum over all ranks, in place."""
        if self._ranks.size > 1:
            self._ranks.Allreduce(MPI.IN_PLACE, y)

    def extend(self, own: Array) -> Array:
        """Return ``own``, the entries of the rows on this rank, followed by those of the others."""
        return own


class Distributed:
    """Every rank holds its subdomains and those of its ghost nodes: see `Replicated`. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks.
    counts : (ranks,)
        Number of subdomains of each rank.
    ghosts : (n,)
        Subdomains of this rank's ghost nodes, in any order.
    columns : int
        Entries of a coarse vector for a subdomain.
    """

    def __init__(self, comm: MPI.Intracomm, counts: Array, ghosts: Array, columns: int) -> None:
        self.comm, self.own = comm, int(counts[comm.rank])
        first = np.concatenate([[0], np.cumsum(counts)])
        self._first, self._ghosts = int(first[comm.rank]), np.unique(ghosts)
        self.held: Array = np.concatenate([self._first + np.arange(self.own), self._ghosts])
        self._halo = Halo(comm, first, self._ghosts, columns, np.float64)
        self._end = self.own * columns

    def local(self, subdomain: Array) -> Array:
        """See `Replicated`."""
        mine = subdomain - self._first
        of_others = self.own + np.searchsorted(self._ghosts, subdomain)
        return np.where((mine >= 0) & (mine < self.own), mine, of_others)

    def gather(self, blocks: Array) -> Array:
        """See `Replicated`."""
        return blocks.copy()

    def add(self, y: Array) -> None:
        """See `Replicated`."""
        flat = y.reshape(-1)
        self._halo.add(flat[self._end :], flat[: self._end])

    def extend(self, own: Array) -> Array:
        """See `Replicated`."""
        self._halo.exchange(own)
        return np.concatenate([own, self._halo.ghosts.ravel()])


_Reason = PETSc.KSP.ConvergedReason
#: E is scaled to a unit diagonal. Diagonal entries below this fraction of the largest are scaled by
#: that fraction instead: the rounding errors of a subdomain without stiffness are not amplified.
_MIN_DIAGONAL = 1e-5
#: Eigenvalues of the scaled E below this are rounding errors of zero: rigid motions of a free body.
_ZERO_EIGENVALUE = 1e-10
#: Up to this many subdomains E is inverted.
MAX_INVERTED = 64


class CoarseMatrix:
    """E. Collective.

    Coarse vectors are (columns subdomains that the rank holds,).

    Parameters
    ----------
    layout : Replicated or Distributed
        The subdomains that this rank holds.
    row, column : (blocks,)
        Positions among these of the blocks to which this rank's nodes contribute.
    columns : int
        Columns of Z per subdomain: rows of a block.
    """

    def __init__(
        self, layout: Replicated | Distributed, row: Array, column: Array, columns: int
    ) -> None:
        self._layout, self._columns = layout, columns
        self._row, self._column = layout.gather(row), layout.gather(column)
        few = len(layout.held) <= MAX_INVERTED and layout.comm.size == 1
        self._solver: _Inverse | _Factors = _Inverse() if few else _Factors(layout)
        self._own = columns * layout.own

    def update(self, contributions: Array) -> int:
        """Set the values of the blocks and invert or factorise E.

        Parameters
        ----------
        contributions : (blocks, columns, columns)
            Those of this rank's nodes.

        Returns
        -------
        int
            0, or a negative ``KSP.ConvergedReason`` if E is not finite or indefinite.
        """
        blocks, comm = self._layout.gather(contributions), self._layout.comm
        if not comm.allreduce(bool(np.isfinite(blocks).all()), op=MPI.LAND):
            return int(_Reason.DIVERGED_NANORINF)
        own = np.zeros((self._layout.own, self._columns))
        on_diagonal = self._row == self._column
        own[self._row[on_diagonal]] = np.einsum("bii->bi", blocks[on_diagonal])
        diagonal = self._layout.extend(own.ravel()).reshape(-1, self._columns)
        largest = comm.allreduce(diagonal.max(initial=0.0), op=MPI.MAX)
        if largest == 0 and comm.allreduce(bool(diagonal.any()), op=MPI.LOR):
            return int(_Reason.DIVERGED_INDEFINITE_MAT)
        # A column of Z that is zero gets a 1 on the diagonal, and no part in a solution.
        zero = diagonal == 0.0
        scale = 1 / np.sqrt(np.maximum(diagonal, _MIN_DIAGONAL * (largest or 1.0)))
        scale = np.where(zero, 0.0, scale)
        blocks *= scale[self._row][:, :, None] * scale[self._column][:, None]
        blocks[on_diagonal] += np.eye(self._columns) * zero[self._row[on_diagonal]][:, None]
        if not self._solver.update(self._row, self._column, blocks):
            return int(_Reason.DIVERGED_INDEFINITE_MAT)
        own_scale = scale.ravel()[: self._own]
        null = own_scale[:, None] * self._solver.null_space
        self._null_space = _orthonormal(null, comm)
        self._solver.rescale(own_scale)
        return 0

    def solve(self, contributions: Array) -> Array:
        """Return E^-1 times the sum over the ranks of coarse vectors, which is set in place."""
        self._layout.add(contributions)
        return self._layout.extend(self._solver.solve(contributions[: self._own]))

    @property
    def singular(self) -> bool:
        """Return whether E has a null space: the rigid motions of a free body."""
        return self._null_space.shape[1] > 0

    def null_part(self, contributions: Array, y: Array) -> Array:
        """Return the null space's part of y plus the sum of ``contributions`` over the ranks."""
        self._layout.add(contributions)
        whole, null = (contributions + y)[: self._own], self._null_space
        return self._layout.extend(null @ _sum(self._layout.comm, null.T @ whole))


def _sum(comm: MPI.Intracomm, own: Array) -> Array:
    """Return the sum over the ranks that share E."""
    return own if comm.size == 1 else np.asarray(comm.allreduce(own))


def _orthonormal(vectors: Array, comm: MPI.Intracomm) -> Array:
    """Return an orthonormal basis of the columns, whose rows are on all ranks."""
    if not vectors.shape[1]:
        return vectors
    if comm.size == 1:
        return np.linalg.qr(vectors)[0]
    for _ in range(2):  # Cholesky QR, repeated (Yamamoto et al. 2015)
        lower = np.linalg.cholesky(_sum(comm, vectors.T @ vectors))
        vectors = np.linalg.solve(lower, vectors.T).T
    return vectors


class _Inverse:
    """The (pseudo-)inverse of a matrix whose diagonal entries are at most 1.

    Attributes
    ----------
    null_space : (rows, n)
        An orthonormal basis of the matrix's null space.
    """

    null_space: Array

    def update(self, row: Array, column: Array, blocks: Array) -> bool:
        """Set the matrix; return False if it has a negative eigenvalue."""
        from scipy.linalg import lapack  # slow to import; small problems have no subdomains

        subdomains, columns = int(row.max(initial=-1)) + 1, blocks.shape[1]
        size = subdomains * columns
        E = np.zeros((size, size))
        E.reshape(subdomains, columns, subdomains, columns)[row, :, column] = blocks
        self.null_space = np.zeros((size, 0))
        factor, failed = lapack.dpotrf(E, lower=1)
        if not failed:
            lower, failed = lapack.dpotri(factor, lower=1)
            inverse = np.tril(lower) + np.tril(lower, -1).T
        if failed or inverse.trace() > 1 / _ZERO_EIGENVALUE:
            values, vectors = np.linalg.eigh((E + E.T) / 2)
            if values[0] < -_ZERO_EIGENVALUE:
                return False
            kept = values > _ZERO_EIGENVALUE
            inverse = (vectors[:, kept] / values[kept]) @ vectors[:, kept].T
            self.null_space = vectors[:, ~kept]
        self._inverse = inverse
        return True

    def rescale(self, scale: Array) -> None:
        """Multiply what `solve` applies by diag(``scale``) from both sides."""
        self._inverse *= scale[:, None] * scale

    def solve(self, rhs: Array) -> Array:
        """Return a solution; the right-hand side is in the range of a singular matrix."""
        solution: Array = self._inverse @ rhs
        return solution


class _Factors:
    """Sparse factors L D L^T by MUMPS.

    Of a singular matrix MUMPS sets the unknowns of vanishing pivots to zero. Such a solution has
    large components in the null space, whose rounding errors in single precision stop conjugate
    gradients; they are removed, as a pseudo-inverse does.

    Parameters
    ----------
    layout : Replicated or Distributed
        The rows on this rank.
    """

    _pc: PETSc.PC
    null_space: Array

    def __init__(self, layout: Replicated | Distributed) -> None:
        self._layout, self._comm = layout, layout.comm

    def update(self, row: Array, column: Array, blocks: Array) -> bool:
        """See `_Inverse`. The pattern is always that of the first call."""
        if not hasattr(self, "_pc"):
            self._create(row, self._layout.held[column], blocks.shape[1])
        self._E.setValuesBlockedCSR(*self._pattern, blocks[self._upper])
        self._E.assemble()
        self._pc.setUp()
        size = self._E.getLocalSize()[0]
        self.null_space = np.zeros((size, 0))
        if vanishing := self._factors.getMumpsInfog(28):
            # With G the solver, E G E = E: r - G E r is in the null space, for every r.
            null = np.random.default_rng(self._comm.rank).random((size, vanishing))
            for vector in null.T:
                self._rhs.array[:] = vector
                self._E.mult(self._rhs, self._solution)
                vector -= self._apply(self._solution.array)
            self.null_space = _orthonormal(null, self._comm)
        return self._factors.getInertia()[0] == 0

    def rescale(self, scale: Array) -> None:
        """See `_Inverse`."""
        self._scale = scale

    def solve(self, rhs: Array) -> Array:
        """See `_Inverse`."""
        return self._scale * self._apply(self._scale * rhs)

    def _apply(self, rhs: Array) -> Array:
        """Return E^-1 times a vector."""
        self._rhs.array[:] = self._without_null_space(rhs)
        self._pc.apply(self._rhs, self._solution)
        return self._without_null_space(self._solution.array)

    def _without_null_space(self, y: Array) -> Array:
        """Return y less its part in the null space."""
        null = self.null_space
        return y - null @ _sum(self._comm, null.T @ y) if null.shape[1] else y

    def _create(self, row: Array, column: Array, columns: int) -> None:
        """Create the matrix of the upper blocks and its PC, which orders the unknowns once."""
        rows, first = self._layout.own, self._layout.held[0] if self._layout.own else 0
        upper = np.flatnonzero(column >= row + first)
        self._upper = upper = upper[np.lexsort((column[upper], row[upper]))]
        start = np.searchsorted(row[upper], np.arange(rows + 1))
        self._pattern = tuple(of.astype(PETSc.IntType) for of in (start, column[upper]))
        sizes = ((columns * rows, None),) * 2
        self._E = PETSc.Mat().createSBAIJ(sizes, columns, csr=self._pattern, comm=self._comm)
        self._rhs, self._solution = self._E.createVecs()
        self._pc = PETSc.PC().create(self._comm)
        self._pc.setOperators(self._E)
        set_direct_factors(self._pc)
        self._pc.setFactorSetUpSolverType()
        self._factors = self._pc.getFactorMatrix()
        self._factors.setMumpsIcntl(24, 1)  # vanishing pivots are detected ...
        self._factors.setMumpsCntl(3, _ZERO_EIGENVALUE)  # ... below this
