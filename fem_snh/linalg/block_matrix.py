"""The C library of the linear solver; a symmetric matrix of blocks, and its SSOR sweeps.

The blocks are 2x2 or 3x3, in single precision. `fem_snh.linalg.ssor_cg` sweeps over the matrix;
`fem_snh.linalg.deflation` reads its pattern.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.errors import BadInput
from fem_snh.kernels import build
from fem_snh.linalg.matrix_parts import DisplacementBlocks

Array = npt.NDArray[Any]

#: Floats in a vector register of block_matrix_kernels.h.
_LANES = 4
_API = ("block_matrix_api.h", "coarse_space_api.h")
_FUNCTIONS = ("block_matrix_kernels.h", "coarse_space_kernels.h")

#: Functions per component and subdomain of Z, one for each lane of a vector register.
FUNCTIONS = 4


def columns(block: int) -> int:
    """Return the columns of Z per subdomain for nodes of ``block`` components."""
    return FUNCTIONS * block


def open_kernels(comm: Any, block: int) -> tuple[Any, Any]:
    """Open the library for matrices whose blocks have ``block`` rows, 2 or 3. Collective.

    Parameters
    ----------
    comm : communicator of mpi4py
        The ranks.
    block : int
        Rows of a block.
    """
    sizes = {"BLOCK": block, "ENTRIES": f"((long){block**2})", "COLUMNS": columns(block)}
    definitions = [f"#define {name} {size}" for name, size in sizes.items()]
    return build.open_library(_API, _FUNCTIONS, definitions, comm=comm)


class SymmetricBlockMatrix:
    """One rank's rows of a symmetric block matrix in single precision (block_matrix_api.h).

    Vectors are (size rows,) float32.

    Parameters
    ----------
    library : (ffi, lib)
        From `open_kernels`, for blocks of this size.
    size : int
        Rows of a block: 2 or 3.
    blocks : DisplacementBlocks
        Where the values are: each row sorted, the pattern symmetric.

    Raises
    ------
    BadInput
        For a row without a diagonal block.
    """

    def __init__(
        self,
        library: tuple[Any, Any],
        size: int,
        blocks: DisplacementBlocks,
    ) -> None:
        self.ffi, self.lib = library
        diagonal, off_diagonal = blocks.diagonal, blocks.off_diagonal
        indptr, indices = diagonal.indptr, diagonal.indices
        self.rows, self.size, entries = len(indptr) - 1, size, size**2
        row = np.repeat(np.arange(self.rows), np.diff(indptr))
        on_diagonal = np.flatnonzero(indices == row)
        if len(on_diagonal) != self.rows:
            raise BadInput(
                "the built-in linear solver: expected a matrix with a diagonal block in every row "
                "(set -ksp_type for another solver)"
            )
        above = indices > row
        upper_start = np.concatenate([[0], np.cumsum(np.bincount(row[above], minlength=self.rows))])
        arrays: dict[str, Array] = {
            "upper_start": upper_start.astype(np.int32),
            "upper_column": indices[above].astype(np.int32),
            "aij_start": indptr.astype(np.int32),
            "aij_diagonal": (on_diagonal - indptr[:-1]).astype(np.int32),
            "aij_offset": diagonal.row_offset,
            "aij_stride": diagonal.stride,
            "upper": np.zeros(entries * upper_start[-1] + _LANES, np.float32),
            "diagonal": np.zeros(entries * self.rows + _LANES, np.float32),
            "diagonal_inverse": np.zeros(entries * self.rows + _LANES, np.float32),
            "link": np.zeros(4 * (self.rows + 1), np.float32),
            "lanes": np.zeros(8 * self.rows, np.float32),
        }
        if off_diagonal is not None:
            arrays["off_diagonal_start"] = np.ascontiguousarray(off_diagonal.indptr, np.int32)
            arrays["off_diagonal_column"] = np.ascontiguousarray(off_diagonal.indices, np.int32)
            arrays["off_diagonal_value"] = off_diagonal.offset
            arrays["off_diagonal_stride"] = off_diagonal.stride
            arrays["off_diagonal"] = np.zeros(entries * len(off_diagonal.indices), np.float32)
            arrays["shift"] = np.zeros(size * self.rows, np.float32)
        self._arrays = arrays  # the struct holds pointers: the arrays must live as long
        pointers = {name: self.pointer(array) for name, array in arrays.items()}
        self.struct = self.ffi.new("SymmetricBlockMatrix *", {"rows": self.rows, **pointers})

    def pointer(self, array: Array) -> Any:
        """Return a C pointer to the memory of ``array``, which the caller keeps alive."""
        return build.pointer(self.ffi, array)

    def weighted_norm_squared(self, p: Array) -> float:
        """Return p.D^-1 p."""
        inverse = self._arrays["diagonal_inverse"][:-_LANES].reshape(-1, self.size, self.size)
        rows = p.reshape(-1, self.size)
        return float(np.einsum("ni,nij,nj->", rows, inverse, rows, dtype=float))

    def fill(self, values: int, off_diagonal: int, scale: float) -> int:
        """Copy the values of an AIJ matrix, given by their addresses, times ``scale``.

        Returns
        -------
        int
            Number of block rows whose diagonal block is not positive definite.
        """
        addresses = self.addresses(values, off_diagonal)
        return int(self.lib.matrix_fill(self.struct, *addresses, scale))

    def largest_diagonal_entry(self, values: int) -> float:
        """Return max ``|A_ii|`` of an AIJ matrix; infinity if an entry is not finite."""
        return float(self.lib.matrix_largest_diagonal(self.struct, *self.addresses(values)))

    def coupled_unknowns(self, values: int, off_diagonal: int) -> Array:
        """Return where a row of the AIJ matrix has a nonzero entry beside its diagonal.

        Parameters
        ----------
        values, off_diagonal : int
            Addresses of the AIJ matrix's values.

        Returns
        -------
        (rows, size) bool
        """
        coupled = np.zeros((self.rows, self.size), np.uint8)
        addresses = self.addresses(values, off_diagonal)
        pointer = self.pointer(coupled)
        self.lib.matrix_coupled_unknowns(self.struct, *addresses, pointer)
        return coupled.astype(bool)

    def addresses(self, *values: int) -> list[Any]:
        """Return addresses of doubles as C pointers."""
        return [self.ffi.cast("double *", address) for address in values]
