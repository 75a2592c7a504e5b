"""The numbering of unknowns, and where a matrix stores the blocks of element matrices.

As in dolfinx, unknowns are numbered in blocks, one block per node: the displacement's components,
or 1 pressure. Every rank numbers its displacement blocks first, then its pressure blocks.

A parallel AIJ matrix stores the columns that a rank owns (diagonal block) and all other columns
(off-diagonal block) separately. Contributions to rows of another rank are summed in a third array.
`fem_snh.linalg.half_matrix.HalfMatrix` stores half of the diagonal block, and apart from it the
blocks on the diagonal.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh._petsc import set_pattern
from fem_snh.arrays import Array
from fem_snh.errors import BadInput
from fem_snh.kernels.block_pattern import BlockPattern, CellPattern, Pattern, unknown_columns
from fem_snh.linalg.block_matrix import DisplacementBlocks
from fem_snh.linalg.half_matrix import HalfMatrix

#: Which value array a block is in, as cell_api.h encodes it: 4 * offset + one of these.
_DIAGONAL, _OFF_DIAGONAL, _SENT = 0, 1, 2
_NUM_ARRAYS = 4
#: Largest encoded position: the compiled loops read 32-bit integers.
_LARGEST = int(np.iinfo(np.int32).max)


class BlockSparsity:
    """A CSR pattern of blocks whose values are stored one matrix row after the other, as in AIJ.

    Parameters
    ----------
    pattern : Pattern
        The pattern of the blocks.
    row_sizes, column_sizes : (block rows,), (block columns,) int
        Unknowns of each block row and of each block column.

    Attributes
    ----------
    indptr, indices : int arrays
        The CSR pattern of blocks, columns sorted.
    row_sizes : (block rows,) int
        As given.
    row_lengths : (block rows,) int
        Values in one matrix row of each block row: the stride between the rows of a block.
    row_offsets : (block rows + 1,) int
        Offset of each block row's first value.
    pattern : Pattern
        As given.
    """

    def __init__(self, pattern: Pattern, row_sizes: Array, column_sizes: Array) -> None:
        self.pattern = pattern
        self.indptr, self.indices = pattern.indptr, pattern.indices
        self.row_sizes = row_sizes
        self._column_sizes = column_sizes
        self.row_lengths = np.diff(self._before()[self.indptr])
        self.row_offsets = np.concatenate([[0], np.cumsum(row_sizes * self.row_lengths)])

    def _before(self) -> Array:
        """Return the number of columns before each block, row after row, and of all."""
        sizes = self._column_sizes[self.indices]
        return np.concatenate([[0], np.cumsum(sizes, dtype=np.int64)])

    def positions(self, array: int) -> Array:
        """Return where each block is stored in the array of this number, encoded as above."""
        before = self._before()
        shift = self.row_offsets[:-1] - before[self.indptr[:-1]]
        before[:-1] += np.repeat(shift, np.diff(self.indptr))
        return np.asarray(4 * before[:-1] + array)


class Received(NamedTuple):
    """Blocks of this rank's rows that another rank sends, row by row.

    Attributes
    ----------
    rows, columns : (n,) int64
        Global block rows and block columns.
    positions : (n,) int64
        Where the blocks are stored, encoded as ``MatrixLayout.block_positions``.
    """

    rows: Array
    columns: Array
    positions: Array


class MatrixLayout:
    """The sparsity pattern of a dof map's cells, and where their blocks are stored. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns.
    pairs : (n, 2) int64, optional
        Global block row and column of further blocks, in rows that this rank owns.
    mat : PETSc.Mat, optional
        A matrix to which the pattern is given in place. Default: a new matrix.
    unit : float, optional
        The size of the values [N/m], to store one half of the matrix: a symmetric one, of one
        space.

    Attributes
    ----------
    mat : PETSc.Mat
        A zero matrix with this pattern: AIJ, or, with a ``unit``, that of ``half``.
    half : HalfMatrix or None
        The half, if it is stored.
    block_positions : (cells, n, n) int32
        For each pair of blocks of each cell 4 * offset + k, with the offset of the pair's first
        value in value array k (0 diagonal block, 1 off-diagonal block, 2 sent rows, 3 the block
        diagonal of a half); negative for blocks whose transposes a half stores.
    row_strides : list of four (local blocks,) int32
        For each of these arrays, the number of values in a matrix row of each local block.
    num_values : tuple of int
        Values of an AIJ matrix in the diagonal and in the off-diagonal block.
    ghosts : (ghost blocks,) int64
        Global numbers of the ghost blocks.
    sent : BlockSparsity
        Pattern of the rows of the ghost blocks, which are sent to their owners.
    received : list of Received
        The blocks received from each rank.

    Raises
    ------
    BadInput
        On every rank, if a rank has more values than a 32-bit offset can address.
    """

    def __init__(
        self,
        dof_map: MixedDofMap,
        pairs: Array | None = None,
        mat: PETSc.Mat | None = None,
        unit: float | None = None,
    ) -> None:
        self.half: HalfMatrix | None = None
        self._dof_map, owned = dof_map, dof_map.is_owned
        self._numbers = numbers = dof_map.local_to_global.astype(np.int32)  # as PETSc's integers
        self.ghosts = numbers[~owned]
        pattern = CellPattern(dof_map.cell_blocks, len(numbers))
        diagonal, off_diagonal, others, positions = self._shared(pattern, pairs, unit)
        self.num_values = int(diagonal.row_offsets[-1]), int(off_diagonal.row_offsets[-1])
        too_many = bool(positions.max(initial=0) > _LARGEST)
        if dof_map.comm.allreduce(too_many, op=MPI.LOR):
            raise BadInput("too many unknowns for one rank: use more ranks (mpirun -n ...)")
        self.block_positions = pattern.of_cells(positions)
        self.row_strides = [np.zeros(len(numbers), np.int32) for _ in range(_NUM_ARRAYS)]
        lengths = {_DIAGONAL: diagonal.row_lengths, _OFF_DIAGONAL: off_diagonal.row_lengths}
        for array, of_rows in (self.half.strides if self.half else lengths).items():
            self.row_strides[array][owned] = of_rows[numbers[owned] - dof_map.owned_range[0]]
        self.row_strides[_SENT][~owned] = self.sent.row_lengths
        del positions, pattern
        if self.half:
            self.mat: PETSc.Mat = self.half.create_mat()
        else:
            self.mat = _create_aij(dof_map, others, diagonal, off_diagonal, mat)

    def _shared(
        self, pattern: CellPattern, pairs: Array | None, unit: float | None
    ) -> tuple[BlockSparsity, BlockSparsity, Array, Array]:
        """Exchange the rows of ghost blocks, and set ``sent`` and ``received``. Collective.

        Returns
        -------
        diagonal, off_diagonal, others
            See `_owned_rows`.
        positions : (blocks of the pattern,) int64
            Where the cells' blocks are stored, encoded as ``block_positions``.
        """
        dof_map = self._dof_map
        sizes, owned, numbers = dof_map.block_sizes, dof_map.is_owned, self._numbers
        first, last = dof_map.owned_range
        rows, columns = pattern.rows(), pattern.indices
        sent = ~owned[rows]

        ghost = np.cumsum(~owned) - 1  # index of a ghost block among the ghosts
        to_send = BlockPattern(ghost[rows[sent]], columns[sent], len(self.ghosts), len(sizes))
        self.sent = BlockSparsity(to_send, sizes[~owned], sizes)
        own = numbers[rows[~sent]], numbers[columns[~sent]]
        received = self._send_to_owners()
        diagonal, off_diagonal, others = self._owned_rows(own, received, pairs)
        if unit is not None:
            parts = diagonal.pattern, off_diagonal.pattern
            create_aij = partial(_aij_of_half, dof_map, others)
            numbers_of_ranks = dof_map.first_blocks, others
            self.half = HalfMatrix(
                dof_map.comm, dof_map.components, unit, create_aij, *parts, *numbers_of_ranks
            )
            of_own, of_others = self.half.positions()
        else:
            of_own = diagonal.positions(_DIAGONAL)
            of_others = off_diagonal.positions(_OFF_DIAGONAL)

        def owned_positions(rows: Array, columns: Array) -> Array:
            row, found = rows - first, np.empty(len(rows), np.int64)
            inside = (columns >= first) & (columns < last)
            found[inside] = of_own[diagonal.pattern.find(row[inside], columns[inside] - first)]
            dense = np.searchsorted(others, columns[~inside])
            found[~inside] = of_others[off_diagonal.pattern.find(row[~inside], dense)]
            return found

        positions = np.empty(len(rows), np.int64)
        positions[~sent] = owned_positions(*own)
        self.received = [Received(r, c, owned_positions(r, c)) for r, c in received]
        in_sent = self.sent.pattern.find(ghost[rows[sent]], columns[sent])
        positions[sent] = self.sent.positions(_SENT)[in_sent]
        return diagonal, off_diagonal, others, positions

    def _owned_rows(
        self, own: Sequence[Array], received: Sequence[Array], pairs: Array | None
    ) -> tuple[BlockSparsity, BlockSparsity, Array]:
        """Return the patterns of this rank's rows, in its own columns and in other columns.

        Parameters
        ----------
        own : two arrays (n,)
            Global block rows and columns of this rank's cells in rows of this rank.
        received : sequence of (2, n)
            Global block rows and columns that each other rank's cells add to these rows.
        pairs : (n, 2), optional
            Global block rows and columns of further blocks.

        Returns
        -------
        diagonal, off_diagonal : BlockSparsity
            The block columns of ``off_diagonal`` are numbered 0, 1, ... by their global numbers.
        others : (n,)
            The global numbers of these block columns, ascending.
        """
        dof_map = self._dof_map
        first, last = dof_map.owned_range
        more = received if pairs is None else [*received, pairs.T.astype(np.int32)]
        parts = zip(own, *more, strict=True)
        rows, columns = map(np.concatenate, parts) if more else own
        rows = rows - first
        inside = (columns >= first) & (columns < last)
        others = np.unique(columns[~inside])
        sizes = dof_map.global_dofs(np.arange(first, last))[1]
        n = len(sizes)
        of_own = BlockPattern(rows[inside], columns[inside] - first, n, n)
        dense = np.searchsorted(others, columns[~inside])
        of_others = BlockPattern(rows[~inside], dense, n, len(others))
        diagonal = BlockSparsity(of_own, sizes, sizes)
        off_diagonal = BlockSparsity(of_others, sizes, dof_map.global_dofs(others)[1])
        return diagonal, off_diagonal, others

    def _send_to_owners(self) -> list[Array]:
        """Send the block pairs of ``sent`` to the owners; return the pairs (2, n) of each rank."""
        comm, dof_map = self._dof_map.comm, self._dof_map
        rows = self.ghosts[self.sent.pattern.rows()]
        owner = dof_map.owner_ranks(rows)
        pairs = np.stack([rows, self._numbers[self.sent.indices]])
        return comm.alltoall([pairs[:, owner == r] for r in range(comm.size)])


class MixedDofMap:
    """The dof maps of several spaces, numbered together on all ranks. Collective.

    Parameters
    ----------
    spaces : sequence of dolfinx function spaces
        The spaces, in the order in which each rank numbers them.

    Attributes
    ----------
    cell_blocks : (cells, blocks of a cell) int
        Local blocks of each cell, one space after the other.
    block_sizes, local_to_global, is_owned : (local blocks,)
        Unknowns, global block number and ownership of each local block.
    first_blocks : (ranks + 1,)
        First global block of each rank, and the number of blocks.
    owned_range : tuple of int
        First global block of this rank, and one past its last.
    num_owned_dofs : int
        Number of unknowns that this rank owns.
    num_blocks, num_owned_blocks, num_cell_blocks : list of int
        For each space, the number of local blocks, ghosts included, of owned blocks, and of blocks
        of a cell.
    """

    def __init__(self, spaces: Sequence[FunctionSpace]) -> None:
        self.comm = comm = spaces[0].mesh.comm
        numbers, cells = (
            [*map(_dolfinx.local_to_global, spaces)],
            [*map(_dolfinx.node_dofs, spaces)],
        )
        self.num_blocks = [*map(len, numbers)]
        self.num_owned_blocks = [_dolfinx.num_nodes(V)[0] for V in spaces]
        self.num_cell_blocks = [blocks.shape[1] for blocks in cells]
        counts = np.array(comm.allgather(self.num_owned_blocks), dtype=np.int64)
        self._space_block_size = np.array([_dolfinx.num_components(V) for V in spaces])
        before = np.vstack([0 * counts[:1], np.cumsum(counts, axis=0)])  # (ranks + 1, spaces)
        self._nodes_before = before[:, 0]
        self.first_blocks = before.sum(axis=1)
        self._first = self.first_blocks[:-1, None] + np.cumsum(counts, axis=1) - counts
        dof_counts = counts * self._space_block_size
        first_dof = (before * self._space_block_size).sum(axis=1)
        self._first_dof = first_dof[:-1, None] + np.cumsum(dof_counts, axis=1) - dof_counts
        self.owned_range = tuple(int(b) for b in self.first_blocks[comm.rank : comm.rank + 2])
        self.num_owned_dofs = int(np.diff(first_dof)[comm.rank])

        global_blocks = []
        for k, of_space in enumerate(numbers):
            rank = np.searchsorted(before[:, k], of_space, side="right") - 1
            global_blocks.append(self._first[rank, k] + of_space - before[rank, k])
        self.local_to_global = np.concatenate(global_blocks)
        self.block_sizes = np.repeat(self._space_block_size, self.num_blocks)
        owned = zip(self.num_blocks, self.num_owned_blocks, strict=True)
        self.is_owned = np.concatenate([np.arange(every) < own for every, own in owned])
        shifts = np.cumsum([0, *self.num_blocks[:-1]])
        cells = [blocks + shift for blocks, shift in zip(cells, shifts, strict=True)]
        self.cell_blocks = np.concatenate(cells, axis=1)

    def displacement_blocks(self, nodes: Array) -> Array:
        """Return the global blocks of global nodes of the first space."""
        rank = np.searchsorted(self._nodes_before, nodes, side="right") - 1
        return self._first[rank, 0] + nodes - self._nodes_before[rank]

    def owner_ranks(self, blocks: Array) -> Array:
        """Return the rank that owns each of these global blocks."""
        return np.searchsorted(self.first_blocks, blocks, side="right") - 1

    def global_dofs(self, blocks: Array) -> tuple[Array, Array]:
        """Return (first global dof, block size) of each of these global blocks."""
        rank = self.owner_ranks(blocks)
        space = (blocks[:, None] >= self._first[rank]).sum(axis=1) - 1
        size = self._space_block_size[space]
        return self._first_dof[rank, space] + size * (blocks - self._first[rank, space]), size

    def blocks_of(self, dofs: Array) -> Array:
        """Return the global blocks of these global dofs."""
        rank = np.searchsorted(self._first_dof[:, 0], dofs, side="right") - 1
        space = (dofs[:, None] >= self._first_dof[rank]).sum(axis=1) - 1
        offset = (dofs - self._first_dof[rank, space]) // self._space_block_size[space]
        return np.asarray(self._first[rank, space] + offset)

    @property
    def components(self) -> int:
        """The unknowns of a block of the first space: the displacement's components."""
        return int(self._space_block_size[0])

    @property
    def cell_block_sizes(self) -> Array:
        """The unknowns of each block of a cell, (blocks of a cell,)."""
        return np.repeat(self._space_block_size, self.num_cell_blocks)

    @property
    def block_size(self) -> int | None:
        """The block size of the space if there is one space; else None."""
        sizes = self._space_block_size
        return int(sizes[0]) if len(sizes) == 1 else None


def _create_aij(
    dof_map: MixedDofMap,
    others: Array,
    diagonal: BlockSparsity,
    off_diagonal: BlockSparsity,
    mat: PETSc.Mat | None = None,
) -> PETSc.Mat:
    """Return a zero AIJ matrix: ``mat`` with a pattern, or a new one for None. Collective.

    ``others`` are the global block columns of ``off_diagonal``.
    """
    row_sizes = diagonal.row_sizes
    lengths = diagonal.row_lengths + off_diagonal.row_lengths
    indptr = np.concatenate([[0], np.cumsum(np.repeat(lengths, row_sizes))])
    first, last = dof_map.owned_range
    own, rest = (
        (part.indptr, part.indices, *dof_map.global_dofs(blocks))
        for part, blocks in ((diagonal, np.arange(first, last)), (off_diagonal, others))
    )
    before = int(np.searchsorted(others, first))
    columns = unknown_columns(row_sizes, own, rest, before, int(indptr[-1]))
    csr = indptr.astype(PETSc.IntType), columns
    if mat is not None:
        set_pattern(mat, csr)
        return mat
    if dof_map.comm.size == 1:  # PETSc keeps these arrays: no copy
        arrays = *csr, np.zeros(len(columns), PETSc.ScalarType)
        size = dof_map.num_owned_dofs
        made = PETSc.Mat().createAIJWithArrays((size, size), arrays, comm=dof_map.comm)
        if dof_map.block_size:
            made.setBlockSize(dof_map.block_size)
        return made
    return PETSc.Mat().createAIJ(
        ((dof_map.num_owned_dofs, None),) * 2,
        bsize=dof_map.block_size,
        csr=csr,
        comm=dof_map.comm,
    )


def _aij_of_half(dof_map: MixedDofMap, others: Array, blocks: DisplacementBlocks) -> PETSc.Mat:
    """Return a zero AIJ matrix of the pattern of a `HalfMatrix`. Collective."""
    own, of_others = blocks.diagonal, blocks.off_diagonal
    count, size = len(own.indptr) - 1, dof_map.components
    none = np.zeros(count + 1, np.int64), np.empty(0, np.int32)
    rows, columns = np.full(count, size), np.full(len(others), size)
    off_diagonal = BlockSparsity(Pattern(*(of_others[:2] if of_others else none)), rows, columns)
    diagonal = BlockSparsity(Pattern(*own[:2]), rows, rows)
    return _create_aij(dof_map, others, diagonal, off_diagonal)
