"""Tabulate, filter and add, in C, the element matrices of terms without compiled cell loops.

`FormCells` tabulates, with FFCx's kernels, the element matrices of energies that users write in UFL
(`fem_snh.terms.ufl_term`). `MatrixAddition` adds the element matrices of any term to the value
arrays of a matrix (`fem_snh.assembly.assembled_matrix`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fem_snh.arrays import Array
from fem_snh.kernels import build

if TYPE_CHECKING:
    from _cffi_backend import CData

#: Eigenvalues above -SHIFT times the largest entry count as non-negative. Relative rounding errors
#: of the rigid motions' eigenvalues are 1e-15, of the single-precision linear solver 1e-7.
SHIFT = 1e-10
#: Eigenvalues above -_ROUNDING times the largest absolute eigenvalue count as non-negative.
_ROUNDING = 1e-12
#: Bytes of a batch of element matrices: it stays in the processor's cache between the steps.
_BATCH = 2**20


def filter_matrices(K: Array, filter: str) -> tuple[Array, int]:
    """Return symmetric matrices with filtered eigenvalues, and how many were indefinite.

    Parameters
    ----------
    K : (m, n, n) array
        Symmetric matrices. Matrices with entries that are not finite are not filtered.
    filter : {"exact", "clamp", "abs"}
        Whether a negative eigenvalue is kept, set to 0, or replaced by its absolute value.

    Returns
    -------
    filtered : (m, n, n) array
        ``K`` itself with "exact", otherwise a copy.
    indefinite : int
        Number of matrices with a negative eigenvalue; 0 with "exact".
    """
    if filter == "exact" or not len(K):
        return K, 0
    finite = np.isfinite(K).all(axis=(1, 2))
    values, vectors = np.linalg.eigh(K[finite])
    kept = np.maximum(values, 0.0) if filter == "clamp" else np.abs(values)
    filtered = K.copy()
    filtered[finite] = (vectors * kept[:, None]) @ vectors.transpose(0, 2, 1)
    negative = values[:, 0] < -_ROUNDING * np.abs(values).max(axis=1, initial=0.0)
    return filtered, int(negative.sum())


class Integral(NamedTuple):
    """One integral of a bilinear form, with the present values of its coefficients.

    Attributes
    ----------
    kernel : int
        Address of FFCx's ``tabulate_tensor``.
    entities : (n,) or (n, 2) int32
        Cells, or for each exterior facet its cell and its number within the cell.
    coefficients : (n, k)
        Packed values of the form's coefficients for each entity.
    constants : (l,)
        Packed values of the form's constants.
    """

    kernel: int
    entities: Array
    coefficients: Array
    constants: Array


class FormCells:
    """Tabulate the element matrices of bilinear forms of a displacement on one rank's cells.

    Parameters
    ----------
    comm : communicator of mpi4py
        The ranks; construction is collective.
    kernel_arguments : int
        Number of arguments of FFCx's kernels, 6 or 7.
    nodes : int
        Displacement nodes of each cell.
    components : int
        Displacement components of a node.
    geometry : (cells, geometry nodes per cell) int32
        Local numbers of each cell's geometry nodes.
    x : (geometry nodes, 3)
        Reference coordinates [m].
    """

    def __init__(
        self,
        comm: Any,
        kernel_arguments: int,
        nodes: int,
        components: int,
        geometry: Array,
        x: Array,
    ) -> None:
        custom = kernel_arguments == 7  # FFCx's kernels have a pointer to custom data since 0.10
        self._ffi, self._lib = build.open_library(
            ["form_cells_api.h"],
            ["form_cells.h"],
            [
                f"#define CUSTOM_DATA_TYPE {', void *' if custom else ''}",
                f"#define CUSTOM_DATA {', 0' if custom else ''}",
            ],
            comm=comm,
        )
        # The struct holds pointers: the arrays must live as long.
        self._geometry = np.ascontiguousarray(geometry, np.int32)
        self._x = np.ascontiguousarray(x, np.float64)
        self._cells = self._ffi.new("FormCells *")
        self._cells.nodes, self._cells.components = nodes, components
        self._cells.geometry_nodes = geometry.shape[1]
        self._cells.geometry = build.pointer(self._ffi, self._geometry)
        self._cells.x = build.pointer(self._ffi, self._x)
        dofs = components * nodes
        batch = max(1, _BATCH // (8 * dofs**2))
        self._matrices, self._work = np.empty((batch, dofs, dofs)), np.empty((dofs, dofs))
        self._indefinite = np.empty(batch, np.int32)

    def matrices(
        self, integral: Integral, filter: str, symmetric: bool = True
    ) -> Iterator[tuple[Array, Array, int]]:
        """Yield an integral's element matrices, or their symmetric parts, batch after batch.

        Parameters
        ----------
        integral : Integral
            The integral.
        filter : {"exact", "clamp", "abs"}
            As for `filter_matrices`.
        symmetric : bool
            Whether to take the symmetric parts. A filter other than "exact" always does.

        Yields
        ------
        cells : (m,) int32
            The cell of each matrix.
        matrices : (m, components * nodes, components * nodes) array
            A view that the next batch overwrites.
        filtered : int
            How many matrices of the batch were not positive semidefinite; 0 with "exact".
        """
        for cells, count, _ in self._batches(integral, symmetric or filter != "exact"):
            filtered = 0 if filter == "exact" else self._filter(count, filter)
            yield cells, self._matrices[:count], filtered

    def asymmetry(self, integral: Integral) -> float:
        """Return the largest max ``|K - K^T|`` / max ``|K|`` of any entity; 0 without entities."""
        return max((asymmetry for _, _, asymmetry in self._batches(integral)), default=0.0)

    def _filter(self, count: int, filter: str) -> int:
        """Filter the first ``count`` matrices in place; return how many are indefinite."""
        arrays = (self._matrices, self._work, self._indefinite)
        matrices, work, numbers = [build.pointer(self._ffi, array) for array in arrays]
        found = self._lib.find_indefinite(len(self._work), count, matrices, SHIFT, work, numbers)
        indefinite = self._indefinite[:found]
        if found:
            self._matrices[indefinite] = filter_matrices(self._matrices[indefinite], filter)[0]
        return int(found)

    def _batches(
        self, integral: Integral, symmetric: bool = True
    ) -> Iterator[tuple[Array, int, float]]:
        """Tabulate batch after batch; yield each batch's cells, their number and its asymmetry."""
        entities = integral.entities
        cells = entities if entities.ndim == 1 else entities[:, 0]
        struct = self._ffi.new("FormIntegral *")
        struct.kernel = self._ffi.cast("void *", integral.kernel)
        struct.width, struct.entities = entities.ndim, build.pointer(self._ffi, entities)
        struct.num_coefficients = integral.coefficients.shape[1]
        struct.coefficients = build.pointer(self._ffi, integral.coefficients)
        struct.constants = build.pointer(self._ffi, integral.constants)
        matrices, batch = build.pointer(self._ffi, self._matrices), len(self._matrices)
        for start in range(0, len(cells), batch):
            count = min(batch, len(cells) - start)
            asymmetry = self._lib.tabulate_entities(
                self._cells, struct, start, count, symmetric, matrices
            )
            yield cells[start : start + count], count, asymmetry


class Addresses(NamedTuple):
    """Where values are added: addresses of the arrays of a ``MatrixTarget``; 0: no such array.

    Attributes
    ----------
    values : sequence of four int
        Arrays of doubles.
    high, rest : sequences of four int
        The halves of split doubles (split_double.h).
    scale : float
        The factor of what is added to split doubles.
    """

    values: Sequence[int] = (0, 0, 0, 0)
    high: Sequence[int] = (0, 0, 0, 0)
    rest: Sequence[int] = (0, 0, 0, 0)
    scale: float = 1.0

    def set(self, target: Any) -> None:
        """Set the addresses and the scale of a ``MatrixTarget *``."""
        cast = build.plain_types().cast
        target.values = [cast("double *", address) for address in self.values]
        target.high = [cast("float *", address) for address in self.high]
        target.rest = [cast("int *", address) for address in self.rest]
        target.scale = self.scale


class MatrixAddition:
    """Add matrices to the value arrays of a matrix, as a ``MatrixTarget`` (cell_api.h) says.

    Rows and columns of constrained displacement components are left out.

    Parameters
    ----------
    cell_blocks : (cells, n) int
        Local numbers of each cell's blocks: displacement nodes, then pressures.
    sizes : (n,) int
        Unknowns of each block of a cell: the displacement components of a node, 1 for a pressure.
    positions : (cells, n, n) int32
        ``MatrixTarget.position``.
    strides : sequence of four (local blocks,) int32
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
        self._ffi, self._lib = build.open_library(
            ["cell_api.h", "matrix_addition_api.h"],
            ["split_double.h", "matrix_target.h", "matrix_addition_kernels.h"],
        )
        self._blocks = np.ascontiguousarray(cell_blocks, dtype=np.int32)
        self._sizes = np.ascontiguousarray(sizes, dtype=np.int32)
        self._dofs = np.cumsum(self._sizes)
        self._kept = positions, tuple(strides), free  # the struct has pointers to these arrays
        self._target = self._ffi.new("MatrixTarget *")
        self._target.position = self._pointer(positions)
        self._target.stride = [self._pointer(stride) for stride in strides]
        self._target.free = self._pointer(free)

    def add(self, addresses: Addresses, cells: Array, matrices: Array) -> None:
        """Add element matrices (n, k, k) of ``cells`` (n,) to the value arrays at ``addresses``.

        k is the number of unknowns of all blocks of a cell, or of its displacement blocks.
        Raises ValueError for another shape of ``matrices``.
        """
        if not len(cells):
            return
        blocks = int(np.searchsorted(self._dofs, matrices.shape[2])) + 1
        if matrices.shape != (len(cells), *[self._dofs[min(blocks, len(self._dofs)) - 1]] * 2):
            raise ValueError(f"matrices of shape {matrices.shape} for {len(cells)} cells")
        cells = np.ascontiguousarray(cells, dtype=np.int32)
        values = np.ascontiguousarray(matrices, dtype=np.float64)
        addresses.set(self._target)
        self._lib.add_matrices(
            self._target, len(cells), self._pointer(cells), blocks, self._blocks.shape[1],
            self._pointer(self._sizes), self._pointer(self._blocks), self._pointer(values),
        )  # fmt: skip

    def add_node_pairs(
        self,
        addresses: Addresses,
        pattern: tuple[Array, Array],
        positions: Array,
        factor: float,
        values: Array,
    ) -> None:
        """Add ``factor * values[k]`` times the identity for each pair k of displacement nodes.

        Parameters
        ----------
        addresses : Addresses
            The value arrays.
        pattern : (indptr, indices)
            A CSR pattern of local nodes, int32.
        positions : (pairs,) int32
            Where the block of each pair is stored, encoded as in ``MatrixTarget.position``.
        factor : float
            Common factor of ``values``.
        values : (pairs,) float64
            One value for each pair.
        """
        addresses.set(self._target)
        indptr, indices = pattern
        self._lib.add_node_pairs(
            self._target, int(self._sizes[0]), len(indptr) - 1, self._pointer(indptr),
            self._pointer(indices), self._pointer(positions), factor, self._pointer(values),
        )  # fmt: skip

    def _pointer(self, array: Array) -> CData:
        return build.pointer(self._ffi, array)
