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

`BodyModes` solves for the linear displacements of the whole body exactly, in double precision. A
stiff body that only inertia or soft springs hold moves almost rigidly. With nodes of mass m and
stiffness k and the time step h, the Rayleigh quotients of the rigid motions are of the order of
:math:`m / (k h^2)` relative to the largest: 1e-8 for steel, cells of 0.2 mm and steps of 0.5 ms. A
matrix in single precision loses them, as its entries are rounded to 1e-7. With the columns of Z,
the displacements linear in the reference coordinates, which contain the rigid motions of a body in
any deformed state,

.. math:: x \mathrel{+}= Z (Z^T A Z)^{-1} Z^T (b - A x)

leaves a residual orthogonal to them: the rest of the solution is elastic, for which single
precision is enough.

References
----------
Nicolaides 1987, SIAM J. Numer. Anal. 24, 355.
Saad, Yeung, Erhel & Guyomarc'h 2000, SIAM J. Sci. Comput. 21, 1909.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh.arrays import Array
from fem_snh.kernels import build
from fem_snh.linalg.block_matrix import (
    FUNCTIONS,
    DisplacementBlocks,
    Halo,
    SymmetricBlockMatrix,
    columns,
)
from fem_snh.linalg.coarse_matrix import CoarseMatrix
from fem_snh.linalg.ssor_cg import LEAST_IN_DOUBLE

if TYPE_CHECKING:
    from _cffi_backend import CData

#: Singular values below this fraction of the largest are dropped: linear functions that coincide at
#: the free nodes of a subdomain (a plane of nodes), with a margin for single precision.
RANK_TOLERANCE = 1e-3


def coordinate_bisection(coordinates: Array, subdomains: int) -> Array:
    """Return the subdomain of each node by recursive coordinate bisection (Berger & Bokhari 1987).

    Each cut is normal to the longest extent and divides the nodes evenly among subdomains.

    Parameters
    ----------
    coordinates : (n, dim)
        Coordinates of the nodes.
    subdomains : int
        Number of subdomains; none is empty if n >= subdomains.

    Returns
    -------
    (n,) int32
        0 to subdomains - 1.
    """
    subdomain = np.zeros(len(coordinates), np.int32)
    queue: list[tuple[Array, int]] = [(np.arange(len(coordinates)), subdomains)]
    made = 0
    while queue:
        nodes, count = queue.pop()
        if count == 1 or len(nodes) < 2:
            subdomain[nodes] = made
            made += 1
            continue
        axis = np.argmax(np.ptp(coordinates[nodes], axis=0))
        middle = len(nodes) * (count // 2) // count
        order = np.argpartition(coordinates[nodes, axis], middle)
        queue += [(nodes[order[:middle]], count // 2), (nodes[order[middle:]], count - count // 2)]
    return subdomain


def linear_functions(coordinates: Array, subdomain: Array, free: Array) -> Array:
    """Return orthonormal linear functions of the coordinates in every subdomain, per component.

    In two dimensions the fourth function is the product of the coordinates. Functions that depend
    linearly on others at the free nodes of a subdomain are zero.

    Parameters
    ----------
    coordinates : (n, dim)
        Reference coordinates of the nodes.
    subdomain : (n,)
        Subdomain of each node.
    free : (n, components) bool
        False where the functions must vanish (constrained components).

    Returns
    -------
    (n, components, 4) float32
        Value of each of the four functions at each node, for each component.
    """
    components = free.shape[1]
    functions = np.zeros((len(coordinates), components, FUNCTIONS), np.float32)
    order = np.argsort(subdomain, kind="stable")
    for nodes in np.split(order, np.flatnonzero(np.diff(subdomain[order])) + 1):
        for component in range(components):
            here = nodes[free[nodes, component]]
            if len(here) == 0:
                continue
            X = coordinates[here] - coordinates[here].mean(axis=0)
            size = np.abs(X).max(initial=0.0)
            X /= size or 1.0
            if X.shape[1] < FUNCTIONS - 1:  # a register has a lane for it; a fifth fewer iterations
                X = np.column_stack([X, X.prod(axis=1)])
            X = np.column_stack([np.ones(len(here)), X])
            U, sigma, _ = np.linalg.svd(X, full_matrices=False)
            kept = sigma > RANK_TOLERANCE * sigma[0]
            functions[here, component, : kept.sum()] = U[:, kept]
    return functions


class Deflation:
    """The deflation space Z of a matrix A, with A Z, E and the projections. Collective.

    Coarse vectors are (columns subdomains,), nodal vectors (size rows,) float32, passed as C
    pointers. Subdomains are numbered across all ranks.

    Parameters
    ----------
    comm : MPI.Intracomm
        The ranks.
    matrix : SymmetricBlockMatrix
        The matrix A.
    blocks : DisplacementBlocks
        The offsets of the values of A.
    halo : Halo or None
        Exchange of the ghost nodes; None on one rank.
    coordinates : (rows, dim)
        Reference coordinates of this rank's nodes.
    subdomains : int
        Number of subdomains on all ranks together; every rank has at least one.

    Attributes
    ----------
    subdomain : (rows + ghosts,) int32
        Subdomain of each node, own nodes first.
    functions : (rows + ghosts, size, 4) float32
        Z by node, component and function.
    E : CoarseMatrix
        The coarse matrix.
    """

    def __init__(
        self,
        comm: MPI.Intracomm,
        matrix: SymmetricBlockMatrix,
        blocks: DisplacementBlocks,
        halo: Halo | None,
        coordinates: Array,
        subdomains: int,
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
        self._columns = columns(matrix.size)
        self.subdomain, count = subdomain, sum(counts)
        self.functions = np.zeros((len(subdomain), matrix.size, FUNCTIONS), np.float32)
        pairs = self._create_space(blocks, count)
        self.E = CoarseMatrix(comm, count, *pairs, self._columns)
        self._free: Array | None = None
        size = self._columns * count
        self._lib, self._y, self._single = matrix.lib, np.zeros(size), np.zeros(size, np.float32)
        self._Qb = np.zeros(size)  # coefficients of Q b in the columns of Z
        self._at_y, self._at_single = (
            build.pointer(matrix.ffi, a) for a in (self._y, self._single)
        )

    def _create_space(self, blocks: DisplacementBlocks, subdomains: int) -> tuple[Array, Array]:
        """Create the C struct; return (row, column) of the blocks of E that this rank adds to."""
        matrix, rows = self._matrix, self._matrix.rows
        subdomain = np.ascontiguousarray(self.subdomain, np.int32)
        diagonal = blocks.diagonal.indptr, blocks.diagonal.indices
        pattern = [np.ascontiguousarray(array, np.int32) for array in diagonal]
        start, work = np.zeros(rows + 1, np.int32), np.zeros(subdomains, np.int32)
        given = [matrix.pointer(array) for array in (*pattern, subdomain, work, start)]
        count = matrix.lib.coarse_pairs(matrix.struct, *given, matrix.ffi.NULL)
        pair_subdomain = np.zeros(count, np.int32)
        matrix.lib.coarse_pairs(matrix.struct, *given, matrix.pointer(pair_subdomain))
        row = np.repeat(np.arange(rows), np.diff(start))
        pair = subdomain[row].astype(np.int64) * subdomains + pair_subdomain
        block, pair_block = np.unique(pair, return_inverse=True)
        self.arrays = {  # the struct holds pointers: the arrays must live as long
            "subdomain": subdomain,
            "functions": self.functions,
            "pair_start": start,
            "pair_subdomain": pair_subdomain,
            "pair_block": pair_block.astype(np.int32),
            "image": np.empty((len(pair_subdomain), matrix.size, self._columns), np.float32),
        }
        pointers = {name: matrix.pointer(array) for name, array in self.arrays.items()}
        self.struct = matrix.ffi.new("CoarseSpace *", {"rows": rows, **pointers})
        self._num_blocks = len(block)
        return np.divmod(block, subdomains)

    def update(self, values: int, off_diagonal: int, scale: float) -> int:
        """Compute Z, A Z and E^-1 for new values of the matrix.

        Parameters
        ----------
        values, off_diagonal : int
            Addresses of the AIJ matrix's values, which are multiplied by ``scale``; 0 without one.

        Returns
        -------
        int
            0, or a negative ``KSP.ConvergedReason`` if E is not finite or indefinite.
        """
        matrix = self._matrix
        self._update_functions(matrix.coupled_unknowns(values, off_diagonal))
        E = np.zeros((self._num_blocks, self._columns, self._columns))
        if values:
            given = *matrix.addresses(values, off_diagonal), scale
            matrix.lib.coarse_assemble(matrix.struct, self.struct, *given, matrix.pointer(E))
        else:
            sums = np.zeros((self._window[1], matrix.size**2, FUNCTIONS))
            given = *self._window, matrix.pointer(sums), matrix.pointer(E)
            matrix.lib.coarse_assemble_half(matrix.struct, self.struct, *given)
        return self.E.update(E)

    @cached_property
    def _window(self) -> tuple[int, int]:
        """The bandwidth and the window of ``coarse_assemble_half``; the pattern determines both."""
        bandwidth = self._matrix.ffi.new("int *")
        window = self._matrix.lib.coarse_window(self._matrix.struct, self.struct, bandwidth)
        return bandwidth[0], window

    def _update_functions(self, free: Array) -> None:
        """Compute Z if the set of coupled unknowns changed."""
        same = self._free is not None and np.array_equal(free, self._free)
        if self._comm.allreduce(same, op=MPI.LAND):
            return
        rows, functions = self._matrix.rows, self.functions
        functions[:rows] = linear_functions(self._coordinates, self.subdomain[:rows], free)
        self._free = free
        if self._halo:
            for k in range(functions.shape[2]):
                self._halo.exchange(np.ascontiguousarray(functions[:rows, :, k]).ravel())
                functions[rows:, :, k] = self._halo.ghosts

    def start(self, r: CData) -> None:
        """Replace r = b by P b and keep Q b for `finish`."""
        self._Qb[:] = self._solve(self._lib.coarse_restrict, r)
        self._lib.coarse_image_subtract(self.struct, self._at_single, r)

    def project(self, t: CData, w: CData) -> None:
        """Compute w -= A Q A t."""
        self._solve(self._lib.coarse_image_transposed, t)
        self._lib.coarse_image_subtract(self.struct, self._at_single, w)

    def finish(self, x: CData) -> None:
        """Replace x by Q b + P^T x, without the part in the null space of A.

        Where A is singular, rounding errors grow in its null space, which no residual shows.
        """
        coarse = self._Qb - self._solve(self._lib.coarse_image_transposed, x)
        if self.E.singular:
            coarse -= self.E.null_part(self._product(self._lib.coarse_restrict, x), coarse)
        self._single[:] = coarse
        self._lib.coarse_prolong(self.struct, self._at_single, x)

    def _solve(self, product: Callable[..., None], vector: CData) -> Array:
        """Return E^-1 y for the y of `_product`; also copy it into ``_single``."""
        y = self.E.solve(self._product(product, vector))
        self._single[:] = y
        return y

    def _product(self, product: Callable[..., None], vector: CData) -> Array:
        """Return this rank's part of Z^T v (restrict) or (A Z)^T v (transposed), in ``_y``."""
        self._y[:] = 0
        product(self.struct, vector, self._at_y)
        return self._y


class BodyModes:
    """Exact solver for the linear displacements of a whole body. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        The matrix.
    coordinates : (rows, dim)
        Reference coordinates of this rank's nodes.
    free : (rows, components) bool
        Which displacements are coupled to others; the other displacements are prescribed.
    scale : float
        One over the largest diagonal entry of A.
    """

    def __init__(self, A: PETSc.Mat, coordinates: Array, free: Array, scale: float) -> None:
        self._comm = A.comm.tompi4py()
        x, y = A.createVecs()
        images = []
        self._Z = _linear(self._comm, coordinates, free)
        for column in self._Z.T:
            x.array[:] = column
            A.mult(x, y)
            images.append(y.array.copy())
        for vector in (x, y):
            vector.destroy()
        self._AZ = np.column_stack(images)
        values, vectors = np.linalg.eigh(scale * self._comm.allreduce(self._Z.T @ self._AZ))
        # Z^T A Z is rounded, too: motions that it loses are left to the iterations.
        known = values > LEAST_IN_DOUBLE
        self._inverse = scale * (vectors[:, known] / values[known]) @ vectors[:, known].T

    def correct(self, x: PETSc.Vec, residual: PETSc.Vec) -> None:
        """Add Z (Z^T A Z)^-1 Z^T (b - A x) to ``x``; update ``residual``, b - A x, as well."""
        y = self._inverse @ self._comm.allreduce(self._Z.T @ residual.array_r)
        x.array[:] += self._Z @ y
        residual.array[:] -= self._AZ @ y


def _linear(comm: MPI.Comm, coordinates: Array, free: Array) -> Array:
    """Return orthonormal columns, (rows components, columns): functions 1 and X of each component.

    They are zero where not ``free`` and orthonormal over all ranks. Functions that depend linearly
    on others are left out.
    """
    count, first = comm.allreduce(np.array([len(coordinates)])), coordinates.sum(axis=0)
    X = coordinates - comm.allreduce(first) / count
    size = np.sqrt(comm.allreduce(float((X**2).sum())) / count)
    functions = np.column_stack([np.ones(len(X)), X / size])
    columns = []
    for component in range(free.shape[1]):
        here = functions * free[:, component, None]
        values, vectors = np.linalg.eigh(comm.allreduce(here.T @ here))
        kept = values > RANK_TOLERANCE**2 * values[-1]
        for column in (here @ (vectors[:, kept] / np.sqrt(values[kept]))).T:
            Z = np.zeros(free.shape)
            Z[:, component] = column
            columns.append(Z.ravel())
    return np.column_stack(columns)
