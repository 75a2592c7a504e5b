"""A symmetric matrix of 2x2 or 3x3 blocks in single precision: a copy of an AIJ matrix, or its own.

`fem_snh.linalg.ssor_cg` sweeps over the matrix; `fem_snh.linalg.deflation` reads its pattern;
`Halo` receives the values of nodes that other ranks own.

The AIJ matrix may be one of the displacement alone, or of displacement and pressure, where every
rank numbers its displacements first (`fem_snh.assembly.matrix_layout`). PETSc sorts the columns
whenever it extracts a submatrix: here the positions of the entries are found once, and only the
values are copied. `part_of` makes the displacement's part a PETSc matrix without values of its own:
a linear solver that copies the values anyway needs no second copy of them in AIJ format.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import AIJBlock, aij_blocks, nonzero_state
from fem_snh.arrays import Array
from fem_snh.errors import BadInput
from fem_snh.kernels import build
from fem_snh.kernels.block_pattern import concatenated_ranges

if TYPE_CHECKING:
    from _cffi_backend import FFI, CData, Lib

#: Floats in a vector register of block_matrix_kernels.h.
_LANES = 4
_API = ("block_matrix_api.h", "coarse_space_api.h")
_FUNCTIONS = ("split_double.h", "block_matrix_kernels.h", "coarse_space_kernels.h")

#: The arrays that a sweep reads: floats of the matrix, then what `SymmetricBlockMatrix.fill` sets.
_SWEPT = ("upper", "off_diagonal", "diagonal", "diagonal_inverse", "link", "shift")

#: The stages of the sweeps, see block_matrix_api.h.
EARLY, INTERIOR, LATE = range(3)
#: Functions in the deflation space Z per component and subdomain: a lane of a vector register each.
FUNCTIONS = 4


def columns(block: int) -> int:
    """Return the number of columns of Z per subdomain for nodes of ``block`` components."""
    return FUNCTIONS * block


def open_kernels(comm: MPI.Comm, block: int) -> tuple[FFI, Lib]:
    """Return (ffi, lib), the compiled kernels for blocks of ``block`` rows, 2 or 3. Collective."""
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
        The offsets of the values; columns ascend in each row, and the pattern is symmetric. Without
        offsets there is no AIJ matrix: the values are in `arrays`, and the addresses of those of
        an AIJ matrix are 0 in all methods.
    halo : Halo or None
        Exchange of the ghost nodes; None on one rank.

    Attributes
    ----------
    arrays : dict of arrays
        The arrays of the C struct.
    translations : (size,) float64
        This rank's part of x.A x, times the scale, of the last `fill`, for each unit translation x
        of all nodes.

    Raises
    ------
    BadInput
        For a row without a diagonal block or a pattern that is not symmetric, after all exchanges.
    """

    def __init__(
        self, library: tuple[FFI, Lib], size: int, blocks: DisplacementBlocks, halo: Halo | None
    ) -> None:
        self.ffi, self.lib = library
        diagonal, off_diagonal = blocks.diagonal, blocks.off_diagonal
        indptr, indices = diagonal.indptr, diagonal.indices
        self.rows, self.size, entries = len(indptr) - 1, size, size**2
        self.translations = np.zeros(size)
        upper = max(0, len(indices) - self.rows) // 2
        computed = ["order", "stage_start", "upper_start", "aij_diagonal"]  # by `matrix_order`
        own = diagonal.offset is None
        arrays: dict[str, Array] = {
            key: np.zeros(self.rows + 4, np.int32) for key in computed + ["place"] * own
        }
        # Of values np.empty: it asks for huge pages, which np.zeros does not. `fill`, or
        # `HalfMatrix.zeroEntries`, writes all of them before they are read.
        if own:
            arrays["half_offset"] = np.zeros(len(indices), np.int32)
            for name, blocks_of in (("own_diagonal", self.rows), ("upper", upper)):
                arrays[f"{name}_rest"] = np.empty(entries * blocks_of + _LANES, np.int32)
            arrays["own_diagonal"] = np.empty(entries * self.rows + _LANES, np.float32)
        else:
            arrays["upper_value"] = np.zeros(upper, np.int32)
            arrays |= {"aij_offset": diagonal.row_offset, "aij_stride": diagonal.stride}
        arrays |= {
            "upper_column": np.zeros(upper, np.int32),
            "aij_start": indptr.astype(np.int32),
            "aij_column": np.ascontiguousarray(indices, np.int32),
            "upper": np.empty(entries * upper + _LANES, np.float32),
            "diagonal": np.empty(entries * self.rows + _LANES, np.float32),
            "diagonal_inverse": np.empty(entries * self.rows + _LANES, np.float32),
            "link": np.zeros(4 * (self.rows + 1), np.float32),
            "lanes": np.full(8 * self.rows, 0, np.float32),
        }
        stage = np.full(size * self.rows, INTERIOR, np.float32)
        self._after: dict[int, list[Halo]] = {EARLY: [], LATE: []}
        if off_diagonal is not None and halo:
            arrays["off_diagonal_start"] = np.ascontiguousarray(off_diagonal.indptr, np.int32)
            arrays["off_diagonal_column"] = np.ascontiguousarray(off_diagonal.indices, np.int32)
            count = entries * len(off_diagonal.indices) + _LANES
            arrays["off_diagonal"] = np.empty(count, np.float32)
            if own:
                arrays["off_diagonal_rest"] = np.empty(count, np.int32)
            else:
                arrays["off_diagonal_value"] = off_diagonal.offset.astype(np.int64)
                arrays["off_diagonal_stride"] = off_diagonal.stride
            arrays["shift"] = np.zeros(size * self.rows, np.float32)
            pattern = (self.pointer(arrays[f"off_diagonal_{key}"]) for key in ("start", "column"))
            self.lib.matrix_stages(self.rows, *pattern, halo.higher, self.pointer(stage))
            halo.exchange(stage)
            arrays["ghost_stage"] = halo.ghosts[:, 0].copy()
            early = arrays["ghost_stage"] == EARLY
            arrays["ghosts"], arrays["other_ghosts"] = both = np.zeros((2, *halo.ghosts.shape), "f")
            self._after[EARLY] = [halo.part(early, ghosts) for ghosts in both]
            self._after[LATE] = [halo.part(~early, both[0])]
        self.arrays = arrays  # the struct holds pointers: the arrays must live as long
        pointers = {name: self.pointer(array) for name, array in arrays.items()}
        one_sided = "ghost_stage" in arrays and bool((arrays["ghost_stage"] == INTERIOR).any())
        self.struct = self.ffi.new("SymmetricBlockMatrix *", {"rows": self.rows, **pointers})
        offsets = self.ffi.NULL if own else self.pointer(diagonal.offset.astype(np.int32))
        if one_sided or self.lib.matrix_order(self.struct, self.pointer(stage), offsets):
            raise BadInput(
                "the built-in linear solver: expected a matrix with a diagonal block in every row "
                "and a symmetric pattern (set -ksp_type for another solver)"
            )

    def sweep(self, kernel: str, values: Sequence[Array], *rest: Any, first: int = EARLY) -> float:
        """Run a kernel's stages from the ``first``, EARLY or LATE; return the result of the last.

        ``rest`` are the kernel's further arguments. During the second stage the first stage's rows
        of ``values``, one or two of their vectors, go to other ranks.
        """
        run, pairs = getattr(self.lib, kernel), list(zip(self._after[first], values, strict=False))
        run(self.struct, first, *rest)
        for halo, vector in pairs:
            halo.begin(vector)
        run(self.struct, INTERIOR, *rest)
        for halo, vector in pairs:
            halo.end(vector)
        return float(run(self.struct, EARLY + LATE - first, *rest))

    def separate(self) -> SymmetricBlockMatrix:
        """Return a matrix whose `copy_floats` and `fill` do not change this one, of its pattern."""
        other = copy(self)
        own = {name: self.arrays[name].copy() for name in _SWEPT if name in self.arrays}
        other.arrays, other.translations = self.arrays | own, self.translations.copy()
        other.struct = self.ffi.new("SymmetricBlockMatrix *", self.struct[0])
        for name, array in own.items():
            setattr(other.struct, name, other.pointer(array))
        return other

    def copy_floats(self, of: SymmetricBlockMatrix) -> None:
        """Copy the floats of U and of other ranks' columns from the matrix of `separate`."""
        for name in _SWEPT[:2]:
            if name in self.arrays:
                np.copyto(self.arrays[name], of.arrays[name])

    def pointer(self, array: Array) -> CData:
        """Return a C pointer to the memory of ``array``, which the caller keeps alive."""
        return build.pointer(self.ffi, array)

    def fill(self, values: int, off_diagonal: int, scale: float) -> int:
        """Copy an AIJ matrix's values, if any, at these addresses, times ``scale``; invert D.

        Returns
        -------
        int
            Number of block rows whose diagonal block is not positive definite.
        """
        addresses = self.addresses(values, off_diagonal)
        translations = self.pointer(self.translations)
        return int(self.lib.matrix_fill(self.struct, *addresses, scale, translations))

    def largest_diagonal_entry(self, values: int) -> float:
        """Return max ``|A_ii|`` of the values at this address; infinity if one is not finite."""
        return float(self.lib.matrix_largest_diagonal(self.struct, *self.addresses(values)))

    def coupled_unknowns(self, values: int, off_diagonal: int) -> Array:
        """Return which rows of the AIJ matrix have a nonzero entry off the diagonal.

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

    def addresses(self, *values: int) -> list[CData]:
        """Return addresses of doubles as C pointers."""
        return [self.ffi.cast("double *", address) for address in values]


class Submatrix:
    """A block of a matrix of displacement and pressure, such as B or B^T. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix whose rows begin with those of the displacement on every rank
        (`fem_snh.assembly.matrix_layout`). Only its pattern is read; `update` reads values.
    index_sets : dict of PETSc.IS
        {"u": IS, "p": IS}, the global indices of each field.
    rows, columns : str
        The fields of the block, "u" or "p".

    Attributes
    ----------
    matrix : PETSc.Mat
        The block.
    pattern : tuple
        The `nonzero_state` of ``A`` at construction.
    """

    def __init__(
        self, A: PETSc.Mat, index_sets: Mapping[str, PETSc.IS], rows: str, columns: str
    ) -> None:
        self.pattern = nonzero_state(A)
        self.matrix = A.createSubMatrix(index_sets[rows], index_sets[columns])
        (size, _), (num_u, _) = A.getLocalSize(), index_sets["u"].getSizes()
        chosen = slice(num_u) if rows == "u" else slice(num_u, size)
        first, counts = A.getOwnershipRanges(), np.array(A.comm.tompi4py().allgather(num_u))
        own = np.arange(size) + first[A.comm.rank]
        self._offsets: list[Array] = []
        with aij_blocks(A, read_only=True) as blocks:
            for block in blocks:
                column = block.ghosts if self._offsets else own
                owner = np.searchsorted(first, column, side="right") - 1
                is_u = column - first[owner] < counts[owner]
                self._offsets.append(_offsets(block, chosen, is_u == (columns == "u")))

    def update(self, A: PETSc.Mat) -> None:
        """Copy the values of ``A``, with the pattern of construction, into `matrix`."""
        with aij_blocks(A, read_only=True) as given, aij_blocks(self.matrix) as own:
            for source, target, offsets in zip(given, own, self._offsets, strict=True):
                np.take(source.array(), offsets, out=target.array(), mode="clip")


def first_offsets(column: Array, start: Array, end: Array, bound: Array | int) -> Array:
    """Return the offset of each row's first column that is at least ``bound``.

    All rows are bisected together.

    Parameters
    ----------
    column : (n,)
        The columns, ascending in each row.
    start : (rows,)
        Offset of each row's first column.
    end : (rows,)
        Offset past each row's last column: the result if all columns are less.
    bound : (rows,) or int
    """
    low, high = start.copy(), end.copy()
    while (found := low >= high).sum() < len(low):
        middle = (low + high) // 2
        less = ~found & (column[np.minimum(middle, len(column) - 1)] < bound)
        low, high = np.where(less, middle + 1, low), np.where(less, high, middle)
    return low


def _offsets(block: AIJBlock, rows: slice, columns: Array) -> Array:
    """Return the offsets of the entries in ``rows`` whose column is true in ``columns``."""
    start, column = block.csr()
    begin, end = start[rows.start or 0], start[rows.stop]
    return begin + np.flatnonzero(columns[column[begin:end]])


class BlockRows(NamedTuple):
    """The displacement's blocks in the diagonal or the off-diagonal block of an AIJ matrix.

    Attributes
    ----------
    indptr : (rows + 1,)
        Index of the first block of each block row.
    indices : (blocks,)
        Block columns; in the off-diagonal block, the index of the ghost node.
    row_offset : (rows,) int64
        Offset of the first value of each block row; None without an AIJ matrix.
    offset : (blocks,) int
        Offset of the first value of each block, or None.
    stride : (rows,) int32
        Values in each row of the AIJ matrix, the same in all rows of a block row, or None.
    """

    indptr: Array
    indices: Array
    row_offset: Any = None
    offset: Any = None
    stride: Any = None


class DisplacementBlocks(NamedTuple):
    """The displacement's blocks in one rank's rows of an AIJ matrix.

    Attributes
    ----------
    diagonal : BlockRows
        The blocks in this rank's columns.
    off_diagonal : BlockRows or None
        The blocks in other ranks' columns; None on one rank.
    first : (ranks + 1,)
        First node of each rank, and the number of nodes.
    ghosts : (n,)
        Global numbers of the ghost nodes.
    """

    diagonal: BlockRows
    off_diagonal: BlockRows | None
    first: Array
    ghosts: Array


class _Part:
    """The context of the Mat of `part_of`: products go through the whole matrix."""

    def __init__(self, whole: PETSc.Mat, unknowns: int) -> None:
        self.whole, self._unknowns = whole, unknowns
        self._vectors = whole.createVecs()

    def mult(self, part: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y = H x; PETSc calls this."""
        whole_x, whole_y = self._vectors
        whole_x.set(0.0)
        whole_x.array[: self._unknowns] = x.array_r
        self.whole.mult(whole_x, whole_y)
        y.array[:] = whole_y.array_r[: self._unknowns]

    def destroy(self, part: PETSc.Mat) -> None:
        """Destroy what `part_of` created; PETSc calls this."""
        for vector in self._vectors:
            vector.destroy()


def part_of(A: PETSc.Mat, unknowns: int, components: int) -> PETSc.Mat:
    """Return the displacement's part of an AIJ matrix, without values of its own. Collective.

    When the values of ``A`` change, the caller must call ``stateIncrease`` of the part.

    Parameters
    ----------
    A : PETSc.Mat
    unknowns : int
        Unknowns of the displacement that this rank owns, the first of its rows.
    components : int
        Components of the displacement.
    """
    return python_matrix(A.comm, unknowns, components, _Part(A, unknowns))


def python_matrix(comm: Any, rows: int, size: int, context: object) -> PETSc.Mat:
    """Return a matrix of type "python" with this rank's rows, in blocks of ``size``. Collective."""
    matrix = PETSc.Mat().create(comm)
    matrix.setSizes(((rows, None),) * 2, bsize=size)
    matrix.setType(PETSc.Mat.Type.PYTHON)
    matrix.setPythonContext(context)
    matrix.setUp()
    return matrix


def stored_in(A: PETSc.Mat) -> PETSc.Mat:
    """Return the matrix that stores the values of ``A``: ``A``, or the whole of `part_of`."""
    context = A.getPythonContext() if A.getType() == PETSc.Mat.Type.PYTHON else None
    return context.whole if isinstance(context, _Part) else A


def displacement_blocks(A: PETSc.Mat) -> DisplacementBlocks:
    """Return the offsets of the displacement's blocks in an AIJ matrix. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix of the displacement alone, or one of `part_of`.
    """
    whole, comm = stored_in(A), A.comm.tompi4py()
    size = A.getBlockSize()
    counts = np.array(comm.allgather(A.getLocalSize()[0])) // size
    first = np.concatenate([[0], np.cumsum(counts)])
    rows = int(counts[comm.rank])
    with aij_blocks(whole, read_only=True) as (diagonal, *off_diagonal):
        own = _leading_blocks(diagonal, rows, size)
        if not off_diagonal:
            return DisplacementBlocks(own, None, first, np.empty(0, np.int32))
        ranges, columns = whole.getOwnershipRanges(), off_diagonal[0].ghosts
        owner = np.searchsorted(ranges, columns, side="right") - 1
        node, component = np.divmod(columns - ranges[owner], size)
        chosen = (node < counts[owner]) & (component == 0)
        number = np.full(len(columns), -1, np.int32)
        number[chosen] = np.arange(chosen.sum())
        others = _chosen_blocks(off_diagonal[0], rows, size, number)
        return DisplacementBlocks(own, others, first, (first[owner] + node)[chosen])


def _first_rows(start: Array, rows: int, size: int) -> tuple[Array, Array]:
    """Return where the first matrix row of each block row begins, and its length, (rows,) each.

    ``start`` is where each row of the matrix begins.
    """
    first = start[: size * rows + 1]
    return first[:-1:size].astype(np.int64), np.diff(first)[::size]


def _leading_blocks(block: AIJBlock, rows: int, size: int) -> BlockRows:
    """Return the displacement's blocks in the diagonal block of an AIJ matrix."""
    start, column = block.csr()
    begin, stride = _first_rows(start, rows, size)
    count, unknowns = stride // size, size * rows
    if len(start) - 1 > unknowns:  # pressures
        count = (first_offsets(column, begin, begin + stride, unknowns) - begin) // size
    indptr = np.concatenate([[0], np.cumsum(count)])
    offset = np.repeat((begin - size * indptr[:-1]).astype(np.int32), count)
    offset += size * np.arange(indptr[-1], dtype=np.int32)
    return BlockRows(indptr, column[offset] // size, begin, offset, stride.astype(np.int32))


def _chosen_blocks(block: AIJBlock, rows: int, size: int, number: Array) -> BlockRows:
    """Return the displacement's blocks in the off-diagonal block of an AIJ matrix.

    Parameters
    ----------
    number : (columns,)
        The node of which a column is the first; -1 for other columns.
    """
    start, column = block.csr()
    begin, stride = _first_rows(start, rows, size)
    offset = concatenated_ranges(begin, stride)
    node = number[column[offset]]
    chosen = node >= 0
    row = np.repeat(np.arange(rows), stride)[chosen]
    indptr = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=rows))])
    return BlockRows(indptr, node[chosen], begin, offset[chosen], stride.astype(np.int32))


@lru_cache
def _node_type(itemsize: int, width: int) -> MPI.Datatype:
    """Return the MPI type of a node's ``width`` values; cached, as it is never freed."""
    scalar = {4: MPI.FLOAT, 8: MPI.DOUBLE}[itemsize]
    return scalar.Create_contiguous(width).Commit()


class Halo:
    """Exchange of nodal values through a PETSc star forest (``PetscSF``). Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The ranks.
    first : (ranks + 1,)
        First global node of each rank, and the number of nodes.
    nodes : (ghosts,)
        Global numbers of the ghost nodes of this rank, ascending.
    width : int
        Number of values of a node.
    dtype : dtype
        Type of the values.

    Attributes
    ----------
    first, nodes
        The parameters.
    ghosts : (ghosts, width)
        The values received by the last `exchange`.
    higher : int
        The first of the ghost nodes that higher ranks own.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        first: np.ndarray,
        nodes: np.ndarray,
        width: int,
        dtype: Any = np.float32,
    ) -> None:
        owner = np.searchsorted(first, nodes, side="right") - 1
        remote = np.column_stack([owner, nodes - first[owner]]).astype(PETSc.IntType)
        self._forest = PETSc.SF().create(comm)
        self._forest.setGraph(int(first[comm.rank + 1] - first[comm.rank]), None, remote)
        self.ghosts: Array = np.zeros((len(nodes), width), dtype)
        self.higher = int(np.searchsorted(nodes, first[comm.rank + 1]))
        self._node = _node_type(self.ghosts.itemsize, width)

    def exchange(self, values: np.ndarray) -> None:
        """Set `ghosts` from the ``values``, (width rows,), of the nodes that each rank owns."""
        self.begin(values)
        self.end(values)

    def begin(self, values: np.ndarray) -> None:
        """Begin an exchange; the values must not change before its end."""
        self._forest.bcastBegin(self._node, values, self.ghosts, MPI.REPLACE)

    def end(self, values: np.ndarray) -> None:
        """End the exchange of ``values``."""
        self._forest.bcastEnd(self._node, values, self.ghosts, MPI.REPLACE)

    def part(self, chosen: Array, ghosts: Array) -> Halo:
        """Return the exchange of the nodes where ``chosen``, (ghosts,) bool, into ``ghosts``."""
        part = copy(self)
        nodes = np.flatnonzero(chosen).astype(PETSc.IntType)
        part._forest, part.ghosts = self._forest.createEmbeddedLeafSF(nodes), ghosts
        return part
