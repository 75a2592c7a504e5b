"""A symmetric matrix to whose stored half, the solver's, element matrices are added directly.

`fem_snh.linalg.ssor_cg` solves with one half of a matrix in single precision. An AIJ matrix to copy
it from would take five times its memory. Instead, every value is split (split_double.h): into the
float that the solver reads, and the 32 bits that it lacks. Products in double precision read both.
Values are scaled by a power of two, so that the largest diagonal entry is at most 1.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from math import frexp, isfinite
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import aij_blocks
from fem_snh.arrays import Array
from fem_snh.errors import on_every
from fem_snh.kernels.block_pattern import Pattern
from fem_snh.kernels.cell_matrices import Addresses
from fem_snh.linalg.block_matrix import (
    BlockRows,
    DisplacementBlocks,
    Halo,
    SymmetricBlockMatrix,
    open_kernels,
    python_matrix,
)

#: The arrays that hold the values: U, other ranks' columns and the block diagonal, numbered as in a
#: ``MatrixTarget`` (cell_api.h).
_ARRAYS = {0: "upper", 1: "off_diagonal", 3: "own_diagonal"}
#: The arrays of the whole matrix's pattern, which only the set-up and copies to AIJ need.
_PATTERN = ("aij_start", "aij_column", "aij_diagonal", "half_offset")
#: Values are added times this and the unit's power of two: those of crushed cells may be 1e47 times
#: the unit, the range of floats.
_SMALL = 2.0**-30
#: The largest diagonal entry is scaled, to a value from 1/2 to 1, only if it is below this or above
#: 1: it takes another pass over the matrix, and the range of floats is wide enough for CG.
_LEAST = 2.0**-40
#: The rest of a value is a multiple of 2^-53 times the power of two of its float, of which frexp
#: returns the exponent plus 1.
_SHIFT = 54


class HalfMatrix:
    """A symmetric matrix of 2x2 or 3x3 blocks, stored as one half: a Mat's context. Collective.

    It does not refer to the Mat of `create_mat`, which refers to it: Python would free neither.

    Parameters
    ----------
    comm : MPI.Comm
        The ranks.
    size : int
        Rows of a block: 2 or 3.
    unit : float
        The size of the values [N/m]: any within a factor of 1e10.
    create_aij : callable
        Returns a zero AIJ matrix of given `DisplacementBlocks`.
    diagonal, off_diagonal : Pattern
        The blocks of this rank's rows in its own columns, and in other ranks' columns, which are
        numbered 0, 1, ... by their global numbers.
    first : (ranks + 1,)
        First block row of each rank, and the number of block rows.
    ghosts : (n,)
        Global numbers of the other ranks' columns, ascending.

    Attributes
    ----------
    matrix : SymmetricBlockMatrix
        The stored half, of which values are `scale` times those of the matrix.
    halo : Halo or None
        The solver's exchange of ghost nodes; None on one rank.
    scale : float
        A power of two.
    unit
        The parameter; another one is for the next assembly.

    Raises
    ------
    BadInput
        On every rank, if a row has no diagonal block, or if the pattern is not symmetric.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        size: int,
        unit: float,
        create_aij: Callable[[DisplacementBlocks], PETSc.Mat],
        diagonal: Pattern,
        off_diagonal: Pattern,
        first: Array,
        ghosts: Array,
    ) -> None:
        self._comm, self.scale, self._create_aij, self.unit = comm, 1.0, create_aij, unit
        self._first, self._ghosts = first, ghosts
        self._aij: PETSc.Mat | None = None
        self._aij_state = -1  # of the Mat when it was copied
        self._whole: tuple[Array, Array]  # the pattern of the copy
        own, others = (BlockRows(part.indptr, part.indices) for part in (diagonal, off_diagonal))
        blocks = DisplacementBlocks(own, others if comm.size > 1 else None, first, ghosts)
        self.halo = Halo(comm, first, ghosts, size) if comm.size > 1 else None
        library = open_kernels(comm, size)
        self.matrix = on_every(comm, SymmetricBlockMatrix, library, size, blocks, self.halo)

    def create_mat(self) -> PETSc.Mat:
        """Return the matrix, of type "python"."""
        size = self.matrix.size
        return python_matrix(self._comm, size * self.matrix.rows, size, self)

    # --- assembly ---------------------------------------------------------------------------------

    def positions(self) -> tuple[Array, Array]:
        """Return ``MatrixTarget.position`` (cell_api.h) of each block of the two patterns, int64.

        It is negative for blocks below the diagonal, of which the transposes are stored. Only once:
        the arrays of the whole pattern are then released, and `blocks` finds it again.
        """
        b, size = dict(self.matrix.arrays), self.matrix.size
        for name in _PATTERN:
            del self.matrix.arrays[name]
            setattr(self.matrix.struct, name, self.matrix.ffi.NULL)
        own = 4 * b["half_offset"].astype(np.int64)
        own[b["aij_start"][:-1] + b["aij_diagonal"][: self.matrix.rows]] += 3
        if not self.halo:
            return own, np.empty(0, np.int64)
        start = b["off_diagonal_start"].astype(np.int64)
        row = np.repeat(np.arange(self.matrix.rows), np.diff(start))
        return own, 4 * (size * (size - 1) * start[row] + size * np.arange(len(row))) + 1

    @property
    def blocks(self) -> DisplacementBlocks:
        """The pattern, without offsets, found from that of the half."""
        matrix, b, others = self.matrix, self.matrix.arrays, None
        start = np.zeros(matrix.rows + 1, np.int32)
        matrix.lib.matrix_pattern(matrix.struct, matrix.pointer(start), matrix.ffi.NULL)
        column = np.empty(start[-1], np.int32)
        matrix.lib.matrix_pattern(matrix.struct, *map(matrix.pointer, (start, column)))
        if self.halo:
            others = BlockRows(b["off_diagonal_start"], b["off_diagonal_column"])
        return DisplacementBlocks(BlockRows(start, column), others, self._first, self._ghosts)

    @property
    def strides(self) -> dict[int, Array]:
        """``MatrixTarget.stride`` of this rank's nodes, (rows,) int32, by the arrays' numbers."""
        b, size, rows = self.matrix.arrays, self.matrix.size, self.matrix.rows
        found = {0: size * np.diff(b["upper_start"][: rows + 1])[b["place"][:rows]]}
        if self.halo:
            found[1] = size * np.diff(b["off_diagonal_start"])
        return found | {3: np.full(rows, size)}

    def addresses(self, sent: Array) -> Addresses:
        """Return where cell loops add their matrices; ``sent`` are the rows of other ranks."""
        arrays = self.matrix.arrays

        def of(end: str) -> list[int]:
            names = [f"{_ARRAYS.get(k)}{end}" for k in range(4)]
            return [arrays[name].ctypes.data if name in arrays else 0 for name in names]

        return Addresses([0, 0, sent.ctypes.data, 0], of(""), of("_rest"), self.scale)

    def add(self, array: int, targets: Array, values: Array) -> None:
        """Add ``values`` at the offsets ``targets`` of one of the arrays."""
        high, rest = (self.matrix.arrays[_ARRAYS[array] + end] for end in ("", "_rest"))
        _split(high, rest, targets, _join(high, rest, targets) + self.scale * values)

    def zeroEntries(self, mat: PETSc.Mat) -> None:
        """Set all values to zero, and the scale to the unit's; PETSc calls this."""
        self.scale = _SMALL * 2.0 ** -frexp(self.unit)[1]
        for name, array in self.matrix.arrays.items():
            if name.removesuffix("_rest") in _ARRAYS.values():
                array[:] = 0

    def finish(self) -> None:
        """Scale the values unless the largest diagonal entry is from _LEAST to 1. Collective."""
        largest = self._comm.allreduce(self.matrix.largest_diagonal_entry(0), op=MPI.MAX)
        if isfinite(largest) and largest > 0 and not _LEAST <= largest <= 1:
            factor = 2.0 ** -frexp(largest)[1]
            self.matrix.lib.matrix_scale(self.matrix.struct, factor)
            self.scale *= factor

    # --- the matrix as PETSc's --------------------------------------------------------------------

    def mult(self, mat: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = A x; PETSc calls this."""
        y.array[:] = self._product(x, absolute=False)

    def absolute_product(self, x: PETSc.Vec) -> Array:
        """Return this rank's part of ``|A| x``. Collective."""
        return self._product(x, absolute=True)

    def norm(self, mat: PETSc.Mat, kind: int) -> float:
        """Return the infinity norm; PETSc calls this."""
        if kind != PETSc.NormType.NORM_INFINITY:
            raise NotImplementedError(f"norm {kind} of a half matrix")
        ones = mat.createVecRight()
        ones.set(1.0)
        sums = self.absolute_product(ones)
        return float(self._comm.allreduce(sums.max(initial=0.0), op=MPI.MAX))

    def getDiagonal(self, mat: PETSc.Mat, diagonal: PETSc.Vec) -> None:
        """Return the diagonal; PETSc calls this."""
        high, rest = self._diagonals()
        diagonal.array[:] = _join(high, rest, ...).ravel() / self.scale

    def setDiagonal(self, mat: PETSc.Mat, diagonal: PETSc.Vec, add: bool) -> None:
        """Set the diagonal, or add to it; PETSc calls this."""
        high, rest = self._diagonals()
        values = self.scale * diagonal.array_r.reshape(high.shape)
        _split(high, rest, ..., values + _join(high, rest, ...) if add else values)

    def _diagonals(self) -> list[Array]:
        """Return views of the halves of the diagonal, (rows, size)."""
        shape = self.matrix.rows, self.matrix.size, self.matrix.size
        arrays = (self.matrix.arrays[f"own_diagonal{end}"] for end in ("", "_rest"))
        return [np.einsum("ijj->ij", a[: np.prod(shape)].reshape(shape)) for a in arrays]

    def aij(self, mat: PETSc.Mat) -> PETSc.Mat:
        """Return an AIJ matrix with the present values, always the same object. Collective."""
        if self._aij is None:
            blocks, near, matrix = self.blocks, mat.getNearNullSpace(), self.matrix
            self._aij = self._create_aij(blocks)
            if near.handle:
                self._aij.setNearNullSpace(near)
            self._whole = blocks.diagonal.indptr, blocks.diagonal.indices
            matrix.struct.aij_start, matrix.struct.aij_column = map(matrix.pointer, self._whole)
        self.update_aij(mat)
        return self._aij

    def update_aij(self, mat: PETSc.Mat) -> None:
        """Copy the values to the matrix of `aij`, if it was asked for. Collective."""
        if self._aij is None or self._aij_state == mat.stateGet():
            return
        self._aij_state, matrix = mat.stateGet(), self.matrix
        with aij_blocks(self._aij) as blocks:
            addresses = [block.values for block in blocks]
            values = matrix.addresses(*addresses, *[0] * (2 - len(addresses)))
            matrix.lib.matrix_to_aij(matrix.struct, self.scale, *values)
        self._aij.stateIncrease()

    def _product(self, x: PETSc.Vec, absolute: bool) -> Array:
        matrix, values = self.matrix, np.ascontiguousarray(x.array_r)
        y = np.empty_like(values)
        ghosts = matrix.ffi.NULL
        if self._double_halo:
            self._double_halo.exchange(values)
            ghosts = matrix.pointer(self._double_halo.ghosts)
        pointers = matrix.pointer(values), ghosts, matrix.pointer(y)
        matrix.lib.matrix_multiply(matrix.struct, absolute, *pointers)
        return np.divide(y, self.scale, out=y)

    @cached_property
    def _double_halo(self) -> Halo | None:
        if not self.halo:
            return None
        return Halo(self._comm, self._first, self._ghosts, self.matrix.size, np.float64)


def _join(high: Array, rest: Array, at: Any) -> Array:
    """Return the values of a split array, indexed by ``at``, float64."""
    f = high[at].astype(np.float64)
    return f + (f != 0) * np.ldexp(rest[at].astype(np.float64), np.frexp(f)[1] - _SHIFT)


def _split(high: Array, rest: Array, at: Any, values: Array) -> None:
    """Store float64 values in a split array, indexed by ``at``."""
    with np.errstate(all="ignore"):  # of values that are not finite
        high[at] = f = values.astype(np.float32)
        rest[at] = np.ldexp(values - f, _SHIFT - np.frexp(f)[1])
