r"""The coarse matrix :math:`E = Z^T A Z` of the deflation, the same on every rank, and its solves.

E has a dense block for each pair of subdomains that share a row of A Z. It is inverted where it is
small. The factors of a larger one are sparse: an inverse would take :math:`O(n^3)` operations, and
:math:`O(n^2)` in every iteration.
"""

from __future__ import annotations

from typing import Any, Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.linalg.direct_solver import set_direct_factors

Array = npt.NDArray[Any]

_Reason = PETSc.KSP.ConvergedReason
#: E is scaled to a unit diagonal. Diagonal entries below this fraction of the largest are scaled by
#: that fraction instead: the rounding errors of a subdomain without stiffness are not amplified.
_MIN_DIAGONAL = 1e-5
#: Eigenvalues of the scaled E below this are rounding errors of zero: rigid motions of a free body.
_ZERO_EIGENVALUE = 1e-10
#: Up to this many subdomains E is inverted.
MAX_INVERTED = 64


class CoarseMatrix:
    """E on every rank. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks.
    row, column : (blocks,)
        Subdomains of the blocks that this rank computes: all blocks of its own subdomains' rows.
    subdomains : int
        Number of subdomains on all ranks.
    columns : int
        Columns of Z per subdomain: rows of a block.

    Attributes
    ----------
    null_space : (columns subdomains, n)
        An orthonormal basis of the vectors y with E y = 0: the rigid motions of a free body.
    """

    null_space: Array

    def __init__(
        self, comm: MPI.Intracomm, row: Array, column: Array, subdomains: int, columns: int
    ) -> None:
        self._comm = comm
        self._row, self._column = (np.concatenate(comm.allgather(of)) for of in (row, column))
        self._counts = [columns**2 * count for count in comm.allgather(len(row))]
        self._columns, self._size = columns, columns * subdomains
        self._solver: _Solver = _Inverse() if subdomains <= MAX_INVERTED else _Factors()

    def update(self, own: Array) -> int:
        """Set the values of this rank's blocks and invert or factorise E.

        Parameters
        ----------
        own : (blocks, columns, columns)
            The values.

        Returns
        -------
        int
            0, or a negative ``KSP.ConvergedReason`` if E is not finite or indefinite.
        """
        blocks = np.empty((len(self._row), self._columns, self._columns))
        self._comm.Allgatherv(own, [blocks, self._counts])
        if not np.isfinite(blocks).all():
            return int(_Reason.DIVERGED_NANORINF)
        diagonal = np.zeros((self._size // self._columns, self._columns))
        on_diagonal = self._row == self._column
        diagonal[self._row[on_diagonal]] = np.einsum("bii->bi", blocks[on_diagonal])
        largest = diagonal.max(initial=0.0)
        if largest < 0 or (largest == 0 and diagonal.any()):
            return int(_Reason.DIVERGED_INDEFINITE_MAT)
        # A column of Z that is zero gets a 1 on the diagonal, and no part in a solution.
        zero = diagonal == 0.0
        scale = 1 / np.sqrt(np.maximum(diagonal, _MIN_DIAGONAL * (largest or 1.0)))
        self._scale = np.where(zero, 0.0, scale)
        blocks *= self._scale[self._row][:, :, None] * self._scale[self._column][:, None]
        blocks[on_diagonal] += np.eye(self._columns) * zero[self._row[on_diagonal]][:, None]
        if not self._solver.update(self._row, self._column, blocks, self._size):
            return int(_Reason.DIVERGED_INDEFINITE_MAT)
        null = self._scale.ravel()[:, None] * self._solver.null_space
        self.null_space = np.linalg.qr(null)[0] if null.size else null
        return 0

    def solve(self, rhs: Array) -> Array:
        """Return E^-1 times a vector of ``columns`` entries for each subdomain."""
        scale = self._scale.ravel()
        return scale * self._solver.solve(scale * rhs)


class _Solver(Protocol):
    """Solves with a matrix whose diagonal entries are at most 1.

    Attributes
    ----------
    null_space : (size, n)
        An orthonormal basis of the matrix's null space.
    """

    null_space: Array

    def update(self, row: Array, column: Array, blocks: Array, size: int) -> bool:
        """Set the matrix; return False if it has a negative eigenvalue."""

    def solve(self, rhs: Array) -> Array:
        """Return a solution; the right-hand side is in the range of a singular matrix."""


class _Inverse:
    """The (pseudo-)inverse."""

    null_space: Array

    def update(self, row: Array, column: Array, blocks: Array, size: int) -> bool:
        """See `_Solver`."""
        from scipy.linalg import lapack  # slow to import; small problems have no subdomains

        E = np.zeros((size, size))
        columns = blocks.shape[1]
        E.reshape(size // columns, columns, -1, columns)[row, :, column] = blocks
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

    def solve(self, rhs: Array) -> Array:
        """See `_Solver`."""
        solution: Array = self._inverse @ rhs
        return solution


class _Factors:
    """Sparse factors L D L^T by MUMPS.

    Of a singular matrix MUMPS sets the unknowns of vanishing pivots to zero. Such a solution has
    large components in the null space, whose rounding errors in single precision stop conjugate
    gradients; they are removed, as a pseudo-inverse does.
    """

    _pc: PETSc.PC
    null_space: Array

    def update(self, row: Array, column: Array, blocks: Array, size: int) -> bool:
        """See `_Solver`. The pattern is always that of the first call."""
        if not hasattr(self, "_pc"):
            self._create(row, column, size, blocks.shape[1])
        self._E.setValuesBlockedCSR(*self._pattern, blocks[self._upper])
        self._E.assemble()
        self._pc.setUp()
        self.null_space = np.zeros((size, 0))
        if vanishing := self._factors.getMumpsInfog(28):
            # With G the solver, E G E = E: r - G E r is in the null space, for every r.
            null = np.random.default_rng(0).random((size, vanishing))
            for vector in null.T:
                self._rhs.array[:] = vector
                self._E.mult(self._rhs, self._solution)
                vector -= self.solve(self._solution.array.copy())
            self.null_space = np.linalg.qr(null)[0]
        return self._factors.getInertia()[0] == 0

    def solve(self, rhs: Array) -> Array:
        """See `_Solver`."""
        null = self.null_space
        self._rhs.array[:] = rhs - null @ (null.T @ rhs)
        self._pc.apply(self._rhs, self._solution)
        solution: Array = self._solution.array - null @ (null.T @ self._solution.array)
        return solution

    def _create(self, row: Array, column: Array, size: int, columns: int) -> None:
        """Create the matrix of the upper blocks and its PC, which orders the unknowns once."""
        upper = np.flatnonzero(column >= row)
        self._upper = upper = upper[np.lexsort((column[upper], row[upper]))]
        start = np.searchsorted(row[upper], np.arange(size // columns + 1))
        self._pattern = tuple(of.astype(PETSc.IntType) for of in (start, column[upper]))
        self._E = PETSc.Mat().createSBAIJ(size, columns, csr=self._pattern, comm=PETSc.COMM_SELF)
        self._rhs, self._solution = self._E.createVecs()
        self._pc = PETSc.PC().create(PETSc.COMM_SELF)
        self._pc.setOperators(self._E)
        set_direct_factors(self._pc)
        self._pc.setFactorSetUpSolverType()
        self._factors = self._pc.getFactorMatrix()
        self._factors.setMumpsIcntl(24, 1)  # vanishing pivots are detected ...
        self._factors.setMumpsCntl(3, _ZERO_EIGENVALUE)  # ... below this
