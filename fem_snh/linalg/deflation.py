r"""Deflated conjugate gradients with rigid motions and linear strains of subdomains.

The error components that converge slowly are those that move or stretch whole regions of the body.
They lie close to the range of Z, whose columns are displacements that are linear in the reference
coordinates in one subdomain and zero elsewhere. Linear functions contain the rotations of a body in
any deformed state. With

.. math::

    E = Z^T A Z, \qquad Q = Z E^{-1} Z^T, \qquad P = I - A Q,

conjugate gradients solve the singular system :math:`P A \hat x = P b`, and

.. math::

    x = Q b + P^T \hat x

solves A x = b: the coarse component Q b is exact. P A has a smaller condition number than A,
because the slow components are removed from its spectrum.

References
----------
Nicolaides 1987, SIAM J. Numer. Anal. 24, 355.
Saad, Yeung, Erhel & Guyomarc'h 2000, SIAM J. Sci. Comput. 21, 1909.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.linalg.block_matrix import SymmetricBlockMatrix, columns
from fem_snh.linalg.coarse_layout import Distributed, Replicated
from fem_snh.linalg.coarse_matrix import CoarseMatrix
from fem_snh.linalg.coarse_space import CoarseSpace, coordinate_bisection, linear_functions
from fem_snh.linalg.displacement_blocks import BlockRows
from fem_snh.linalg.halo import Halo

Array = npt.NDArray[Any]


class Deflation:
    """The deflation space of a matrix: the operators P, Q and P^T. Collective.

    Vectors of the methods are (size rows,) float32, passed as C pointers.

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks.
    matrix : SymmetricBlockMatrix
        The matrix A.
    diagonal, off_diagonal : BlockRows
        Its blocks, as `SymmetricBlockMatrix` takes them.
    halo : Halo or None
        Exchange of the ghost nodes; None on one rank.
    coordinates : (rows, dim)
        Reference coordinates of this rank's nodes.
    subdomains : int
        Number of subdomains on all ranks together; every rank has at least one.
    replicated : int
        Up to so many of them every rank holds E; of more, only its rows.

    Attributes
    ----------
    coarse : CoarseSpace
        Z and A Z.
    E : CoarseMatrix
        The coarse matrix.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        matrix: SymmetricBlockMatrix,
        diagonal: BlockRows,
        off_diagonal: BlockRows | None,
        halo: Halo | None,
        coordinates: Array,
        subdomains: int,
        replicated: int,
    ) -> None:
        self._comm, self._matrix, self._halo = comm, matrix, halo
        self._coordinates = coordinates
        rows = len(coordinates)
        share = round(subdomains * rows / max(1, comm.allreduce(rows)))
        own = min(rows, max(1, share))
        counts = comm.allgather(own)
        subdomain = sum(counts[: comm.rank]) + coordinate_bisection(coordinates, own)
        if halo:
            halo.exchange(np.repeat(subdomain, matrix.size).astype(np.float32))  # exact up to 2^24
            subdomain = np.concatenate([subdomain, halo.ghosts[:, 0].astype(np.int32)])
        layout: Replicated | Distributed = Replicated(comm, sum(counts))
        if halo and sum(counts) > replicated:
            layout = Distributed(comm, counts, subdomain[rows:], columns(matrix.size))
        subdomain, held = layout.local(subdomain), len(layout.held)
        self.coarse = CoarseSpace(matrix, diagonal, off_diagonal, subdomain, held)
        rows_and_columns = self.coarse.block_row, self.coarse.block_column
        self.E = CoarseMatrix(layout, *rows_and_columns, self.coarse.columns)
        self._free: Array | None = None
        size = self.coarse.columns * held
        self._rhs, self._single = np.zeros(size), np.zeros(size, np.float32)
        self._Qb = np.zeros(size)  # coefficients of Q b in the columns of Z
        self._rhs_pointer = matrix.pointer(self._rhs)
        self._single_pointer = matrix.pointer(self._single)

    @property
    def nbytes(self) -> int:
        """Return the bytes of A Z on this rank, which an iteration reads twice."""
        return self.coarse.nbytes

    @property
    def size(self) -> int:
        """Return the number of columns of Z that this rank holds."""
        return len(self._rhs)

    def update(self, values: int, off_diagonal: int, scale: float) -> int:
        """Compute Z, A Z and E^-1 for new values of the matrix.

        Parameters
        ----------
        values, off_diagonal : int
            Addresses of the AIJ matrix's values, which are multiplied by ``scale``.

        Returns
        -------
        int
            0, or a negative ``KSP.ConvergedReason`` if E is not finite or indefinite.
        """
        self._update_functions(self._matrix.coupled_unknowns(values, off_diagonal))
        return self.E.update(self.coarse.assemble(values, off_diagonal, scale))

    def start(self, r: Any) -> None:
        """Replace r = b by P b and keep Q b for `finish`."""
        self._Qb[:] = self._solve("coarse_restrict", r)
        self._matrix.lib.coarse_image_subtract(self.coarse.struct, self._single_pointer, r)

    def project(self, t: Any, w: Any) -> None:
        """Compute w -= A Q A t."""
        self._solve("coarse_image_transposed", t)
        self._matrix.lib.coarse_image_subtract(self.coarse.struct, self._single_pointer, w)

    def finish(self, x: Any) -> None:
        """Replace x by Q b + P^T x, without the part in the null space of A.

        Where A is singular, rounding errors grow in its null space, which no residual shows.
        """
        coarse = self._Qb - self._solve("coarse_image_transposed", x)
        if self.E.singular:
            coarse -= self.E.null_part(self._product("coarse_restrict", x), coarse)
        self._single[:] = coarse
        self._matrix.lib.coarse_prolong(self.coarse.struct, self._single_pointer, x)

    def _solve(self, transposed: str, vector: Any) -> Array:
        """Return E^-1 y, and store it in _single, for the y of `_product`."""
        solution = self.E.solve(self._product(transposed, vector))
        self._single[:] = solution
        return solution

    def _product(self, transposed: str, vector: Any) -> Array:
        """Return this rank's part of Z^T v (coarse_restrict) or (A Z)^T v (.._transposed)."""
        self._rhs[:] = 0
        getattr(self._matrix.lib, transposed)(self.coarse.struct, vector, self._rhs_pointer)
        return self._rhs

    def _update_functions(self, free: Array) -> None:
        """Compute Z if the set of coupled unknowns changed."""
        same = self._free is not None and np.array_equal(free, self._free)
        if self._comm.allreduce(same, op=MPI.LAND):
            return
        rows, functions = self._matrix.rows, self.coarse.functions
        own = self.coarse.subdomain[:rows]
        functions[:rows] = linear_functions(self._coordinates, own, free)
        self._free = free
        if self._halo:
            for k in range(functions.shape[2]):
                self._halo.exchange(np.ascontiguousarray(functions[:rows, :, k]).ravel())
                functions[rows:, :, k] = self._halo.ghosts
