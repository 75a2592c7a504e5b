"""The deflation space: subdomains, linear functions on them, and the matrix's product with them.

`fem_snh.linalg.deflation` builds its projections on it.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels.block_pattern import BlockPattern
from fem_snh.linalg.block_matrix import FUNCTIONS, SymmetricBlockMatrix, columns
from fem_snh.linalg.displacement_blocks import BlockRows

Array = npt.NDArray[Any]

#: Singular values below this fraction of the largest are dropped: linear functions that coincide at
#: the free nodes of a subdomain (a plane of nodes), with a margin for single precision.
RANK_TOLERANCE = 1e-3


def coordinate_bisection(coordinates: Array, subdomains: int) -> Array:
    """Return the subdomain of each node by recursive coordinate bisection (Berger & Bokhari 1987).

    Each cut is normal to the longest extent and halves the number of nodes.

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

    In two dimensions the fourth is the product of the coordinates. Functions that the free nodes of
    a subdomain do not distinguish from others are zero.

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


class CoarseSpace:
    """Z and A Z in single precision (coarse_space_api.h).

    Coarse vectors are (columns subdomains,), nodal vectors (size rows,) float32. Subdomains are
    numbered as this rank holds them (`fem_snh.linalg.coarse_layout`).

    Parameters
    ----------
    matrix : SymmetricBlockMatrix
        The matrix A.
    diagonal, off_diagonal : BlockRows
        Its blocks, as `SymmetricBlockMatrix` takes them.
    subdomain : (rows + ghosts,) int32
        Subdomain of each node, own nodes first.
    subdomains : int
        Number of subdomains that this rank holds.

    Attributes
    ----------
    functions : (rows + ghosts, size, 4) float32
        Z by node, component and function; the caller sets it before `assemble`.
    block_row, block_column : (blocks,)
        The subdomains of the blocks of E = Z^T A Z to which this rank's rows contribute.
    """

    def __init__(
        self,
        matrix: SymmetricBlockMatrix,
        diagonal: BlockRows,
        off_diagonal: BlockRows | None,
        subdomain: Array,
        subdomains: int,
    ) -> None:
        self._matrix, self.subdomain, self.subdomains = matrix, subdomain, subdomains
        size, self.columns = matrix.size, columns(matrix.size)
        self.functions = np.zeros((len(subdomain), size, FUNCTIONS), np.float32)
        rows = matrix.rows
        parts = [
            (np.repeat(np.arange(rows), np.diff(blocks.indptr)), subdomain[blocks.indices + shift])
            for blocks, shift in ((diagonal, 0), (off_diagonal, rows))
            if blocks is not None
        ]
        row_of_block, of_column = (np.concatenate(part) for part in zip(*parts, strict=True))
        pairs = BlockPattern(row_of_block, of_column, rows, subdomains)
        row, pair_subdomain = pairs.rows(), pairs.indices
        pair = subdomain[row].astype(np.int64) * subdomains + pair_subdomain
        block, pair_block = np.unique(pair, return_inverse=True)
        self.block_row, self.block_column = np.divmod(block, subdomains)
        self.arrays = {
            "subdomain": np.ascontiguousarray(subdomain, np.int32),
            "functions": self.functions,
            "aij_column": np.ascontiguousarray(diagonal.indices, np.int32),
            "pair_start": pairs.indptr.astype(np.int32),
            "pair_subdomain": pair_subdomain,
            "pair_block": pair_block.astype(np.int32),
            "image": np.zeros((len(pair_subdomain), size, self.columns), np.float32),
        }
        read = ("image", "pair_start", "pair_subdomain")
        self.nbytes = sum(self.arrays[name].nbytes for name in read)
        pointers = {name: matrix.pointer(array) for name, array in self.arrays.items()}
        self.struct = matrix.ffi.new("CoarseSpace *", {"rows": rows, **pointers})

    def assemble(self, values: int, off_diagonal: int, scale: float) -> Array:
        """Compute A Z and return the blocks of E = Z^T A Z, whose rows are of this rank alone.

        Parameters
        ----------
        values, off_diagonal : int
            Addresses of the AIJ matrix's values, which are multiplied by ``scale``.

        Returns
        -------
        (blocks, columns, columns)
        """
        matrix = self._matrix
        E = np.zeros((len(self.block_row), self.columns, self.columns))
        addresses = matrix.addresses(values, off_diagonal)
        matrix.lib.coarse_assemble(matrix.struct, self.struct, *addresses, scale, matrix.pointer(E))
        return E
