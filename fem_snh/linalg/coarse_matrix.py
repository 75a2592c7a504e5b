r"""The coarse matrix :math:`E = Z^T A Z` of the deflation, and its solves.

E has a dense block for each pair of subdomains that share a row of A Z. A small E is inverted. A
larger E has sparse factors: an inverse would take :math:`O(n^3)` operations, and :math:`O(n^2)` in
every iteration.

Every rank has the whole of E: a solve takes one sum over the ranks, then each rank solves.
"""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh.arrays import Array
from fem_snh.linalg.direct_solver import set_direct_factors

_Reason = PETSc.KSP.ConvergedReason
#: E is scaled to a unit diagonal. Diagonal entries below this fraction of the largest are scaled by
#: that fraction instead: the rounding errors of a subdomain without stiffness are not amplified.
_MIN_DIAGONAL = 1e-5
#: Eigenvalues of the scaled E below this are rounding errors of zero: rigid motions of a free body.
_ZERO_EIGENVALUE = 1e-10
#: Up to this many subdomains E is inverted. With 64 subdomains the inverse takes 24 ms and the
#: factors 5.5 ms, a solve 0.28 and 0.45 ms: a Newton step of the stretch on two ranks takes 212 and
#: 194 ms; with 14 subdomains both take as long (docs/results/speed.md).
MAX_INVERTED = 16


class CoarseMatrix:
    """The coarse matrix E with its inverse or its factors. Collective.

    Coarse vectors are (columns subdomains,).

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks whose contributions are added up.
    subdomains : int
        Number of subdomains on all ranks.
    row, column : (blocks,)
        Subdomains of the blocks to which this rank's nodes contribute.
    columns : int
        Columns of Z per subdomain: rows of a block.
    """

    def __init__(
        self, comm: MPI.Intracomm, subdomains: int, row: Array, column: Array, columns: int
    ) -> None:
        self._comm, self._shape = comm, (subdomains, columns)
        self._row, self._column = self._gathered(row), self._gathered(column)
        few = subdomains <= MAX_INVERTED
        self._solver: _Inverse | _Factors = _Inverse(subdomains) if few else _Factors(subdomains)

    def update(self, contributions: Array) -> int:
        """Set the values of the blocks and invert or factorise E.

        Parameters
        ----------
        contributions : (blocks, columns, columns)
            This rank's part of each block in ``row`` and ``column``.

        Returns
        -------
        int
            0, or a negative ``KSP.ConvergedReason`` if E is not finite or indefinite.
        """
        blocks = self._gathered(contributions)
        if not np.isfinite(blocks).all():
            return int(_Reason.DIVERGED_NANORINF)
        diagonal = np.zeros(self._shape)
        on_diagonal = self._row == self._column
        diagonal[self._row[on_diagonal]] = np.einsum("bii->bi", blocks[on_diagonal])
        largest = diagonal.max(initial=0.0)
        if largest == 0 and diagonal.any():
            return int(_Reason.DIVERGED_INDEFINITE_MAT)
        # A column of Z that is zero gets a 1 on the diagonal, and no part in a solution.
        zero = diagonal == 0.0
        scale = 1 / np.sqrt(np.maximum(diagonal, _MIN_DIAGONAL * (largest or 1.0)))
        scale = np.where(zero, 0.0, scale)
        blocks *= scale[self._row][:, :, None] * scale[self._column][:, None]
        blocks[on_diagonal] += np.eye(self._shape[1]) * zero[self._row[on_diagonal]][:, None]
        if not self._solver.update(self._row, self._column, blocks):
            return int(_Reason.DIVERGED_INDEFINITE_MAT)
        self._null_space = np.linalg.qr(scale.reshape(-1, 1) * self._solver.null_space)[0]
        self._solver.rescale(scale.ravel())
        return 0

    def solve(self, contributions: Array) -> Array:
        """Return E^-1 y; ``contributions`` becomes y, its sum over the ranks."""
        self._add(contributions)
        return self._solver.solve(contributions)

    @property
    def singular(self) -> bool:
        """Return whether E has a null space: the rigid motions of a free body."""
        return self._null_space.shape[1] > 0

    def null_part(self, contributions: Array, y: Array) -> Array:
        """Return the projection of ``y`` plus all ranks' ``contributions`` onto the null space."""
        self._add(contributions)
        part: Array = self._null_space @ (self._null_space.T @ (contributions + y))
        return part

    def _gathered(self, blocks: Array) -> Array:
        """Return all ranks' ``blocks``, concatenated."""
        counts, entries = self._comm.allgather(len(blocks)), int(np.prod(blocks.shape[1:]))
        gathered = np.empty((sum(counts), *blocks.shape[1:]), blocks.dtype)
        self._comm.Allgatherv(blocks, [gathered, [entries * count for count in counts]])
        return gathered

    def _add(self, y: Array) -> None:
        """Replace a coarse vector by its sum over all ranks."""
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, y)


class _Inverse:
    """The (pseudo-)inverse of a symmetric matrix whose diagonal entries are at most 1.

    Attributes
    ----------
    null_space : (rows, n)
        An orthonormal basis of the matrix's null space.
    """

    null_space: Array

    def __init__(self, subdomains: int) -> None:
        self._subdomains = subdomains

    def update(self, row: Array, column: Array, blocks: Array) -> bool:
        """Invert the matrix of ``blocks`` at (``row``, ``column``); return False if indefinite."""
        from scipy.linalg import lapack  # slow to import; small problems have no subdomains

        subdomains, columns = self._subdomains, blocks.shape[1]
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
        """Multiply the inverse that `solve` applies by diag(``scale``) from both sides."""
        self._inverse *= scale[:, None] * scale

    def solve(self, rhs: Array) -> Array:
        """Return a solution; ``rhs`` is in the range of a singular matrix."""
        solution: Array = self._inverse @ rhs
        return solution


class _Factors:
    """Sparse factors L D L^T by MUMPS.

    MUMPS sets the unknowns of a singular matrix's vanishing pivots to zero. The solution then has
    large components in the null space, whose rounding errors in single precision stop conjugate
    gradients; `solve` removes these components, as a pseudo-inverse does.
    """

    _pc: PETSc.PC
    null_space: Array

    def __init__(self, subdomains: int) -> None:
        self._subdomains = subdomains

    def update(self, row: Array, column: Array, blocks: Array) -> bool:
        """See `_Inverse.update`. The pattern must be that of the first call."""
        if not hasattr(self, "_pc"):
            self._create(row, column, blocks.shape[1])
        self._E.setValuesBlockedCSR(*self._pattern, blocks[self._upper])
        self._E.assemble()
        self._pc.setUp()
        size = self._E.getLocalSize()[0]
        self.null_space = np.zeros((size, 0))
        if vanishing := self._factors.getMumpsInfog(28):
            # With G the solver, E G E = E: r - G E r is in the null space, for every r.
            null = np.random.default_rng(0).random((size, vanishing))
            for vector in null.T:
                self._rhs.array[:] = vector
                self._E.mult(self._rhs, self._solution)
                vector -= self._apply(self._solution.array)
            self.null_space = np.linalg.qr(null)[0]
        return self._factors.getInertia()[0] == 0

    def rescale(self, scale: Array) -> None:
        """See `_Inverse.rescale`."""
        self._scale = scale

    def solve(self, rhs: Array) -> Array:
        """See `_Inverse.solve`."""
        return self._scale * self._apply(self._scale * rhs)

    def _apply(self, rhs: Array) -> Array:
        """Return E^-1 times a vector, without components in the null space."""
        self._rhs.array[:] = self._without_null_space(rhs)
        self._pc.apply(self._rhs, self._solution)
        return self._without_null_space(self._solution.array)

    def _without_null_space(self, y: Array) -> Array:
        """Return y less its projection onto the null space."""
        null = self.null_space
        return y - null @ (null.T @ y) if null.shape[1] else y

    def _create(self, row: Array, column: Array, columns: int) -> None:
        """Create the matrix of the upper blocks and its PC, which orders the unknowns once."""
        upper = np.flatnonzero(column >= row)
        self._upper = upper = upper[np.lexsort((column[upper], row[upper]))]
        start = np.searchsorted(row[upper], np.arange(self._subdomains + 1))
        self._pattern = tuple(of.astype(PETSc.IntType) for of in (start, column[upper]))
        comm, sizes = PETSc.COMM_SELF, (columns * self._subdomains,) * 2
        self._E = PETSc.Mat().createSBAIJ(sizes, columns, csr=self._pattern, comm=comm)
        self._rhs, self._solution = self._E.createVecs()
        self._pc = PETSc.PC().create(comm)
        self._pc.setOperators(self._E)
        set_direct_factors(self._pc)
        self._pc.setFactorSetUpSolverType()
        self._factors = self._pc.getFactorMatrix()
        self._factors.setMumpsIcntl(24, 1)  # vanishing pivots are detected ...
        self._factors.setMumpsCntl(3, _ZERO_EIGENVALUE)  # ... below this
