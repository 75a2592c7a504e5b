"""Add stored matrices to the value arrays of an AIJ matrix, in C.

`fem_snh.assembly.assembled_matrix` calls it for terms without compiled cell loops of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels import build
from fem_snh.kernels.headers import header

Array = npt.NDArray[Any]

_DECLARATIONS = ("cell_api.h", "matrix_addition_api.h")


class MatrixAddition:
    """Addition of matrices at the positions that a ``MatrixTarget`` (cell_api.h) holds.

    Parameters
    ----------
    cell_blocks : (cells, n) int
        Local block numbers of each cell.
    sizes : (n,) int
        Unknowns of each block of a cell: the displacement's components, then 1 for a pressure's.
    positions : (cells, n, n) int32
        ``MatrixTarget.position``.
    strides : sequence of three (local blocks,) int32
        ``MatrixTarget.stride``.
    free : (local nodes, components)
        ``MatrixTarget.free``.
    """

    def __init__(
        self,
        cell_blocks: Array,
        sizes: Array,
        positions: Array,
        strides: Sequence[Array],
        free: Array,
    ) -> None:
        declarations = "\n".join(map(header, _DECLARATIONS))
        source = "\n".join([declarations, header("matrix_addition_kernels.h")])
        self._ffi, self._lib = build.load(build.library(source), declarations)
        self._blocks = np.ascontiguousarray(cell_blocks, dtype=np.int32)
        self._sizes = np.ascontiguousarray(sizes, dtype=np.int32)
        self._dofs = np.cumsum(self._sizes)
        self._kept = positions, tuple(strides), free  # the struct has pointers to these arrays
        self._target = self._ffi.new("MatrixTarget *")
        self._target.position = self._pointer(positions)
        self._target.stride = [self._pointer(stride) for stride in strides]
        self._target.free = self._pointer(free)

    def add(self, addresses: Sequence[int], cells: Array, matrices: Array) -> None:
        """Add element matrices (n, k, k) of ``cells`` (n,) to the value arrays at ``addresses``.

        k is the number of dofs of all blocks of a cell, or of its displacement blocks.
        """
        if not len(cells):
            return
        blocks = int(np.searchsorted(self._dofs, matrices.shape[2])) + 1
        if matrices.shape != (len(cells), *[self._dofs[min(blocks, len(self._dofs)) - 1]] * 2):
            raise ValueError(f"matrices of shape {matrices.shape} for {len(cells)} cells")
        cells = np.ascontiguousarray(cells, dtype=np.int32)
        values = np.ascontiguousarray(matrices, dtype=np.float64)
        self._set_addresses(addresses)
        self._lib.add_matrices(
            self._target, len(cells), self._pointer(cells), blocks, self._blocks.shape[1],
            self._pointer(self._sizes), self._pointer(self._blocks), self._pointer(values),
        )  # fmt: skip

    def add_node_pairs(
        self,
        addresses: Sequence[int],
        pattern: tuple[Array, Array],
        positions: Array,
        factor: float,
        values: Array,
    ) -> None:
        """Add ``factor * values[k]`` times the identity for each pair k of displacement nodes.

        Parameters
        ----------
        addresses : sequence of three int
            The value arrays.
        pattern : (indptr, indices)
            A CSR pattern of local nodes, int32.
        positions : (pairs,) int32
            Where the block of each pair is stored, encoded as in ``MatrixTarget.position``.
        factor, values : float, (pairs,) float64
            What is added.
        """
        self._set_addresses(addresses)
        indptr, indices = pattern
        self._lib.add_node_pairs(
            self._target, int(self._sizes[0]), len(indptr) - 1, self._pointer(indptr),
            self._pointer(indices), self._pointer(positions), factor, self._pointer(values),
        )  # fmt: skip

    def _set_addresses(self, addresses: Sequence[int]) -> None:
        self._target.values = [self._ffi.cast("double *", address) for address in addresses]

    def _pointer(self, array: Array) -> Any:
        return build.pointer(self._ffi, array)
