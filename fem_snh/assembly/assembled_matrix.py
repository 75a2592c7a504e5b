"""A matrix into whose value arrays the terms of a problem add element matrices directly.

``MatSetValues`` searches the row of every value for its column, in every assembly. The sparsity
pattern of a mesh's cells never changes, so `BlockMatrix` determines once where the value arrays of
PETSc's AIJ matrix, or of the solver's half, store each block of each element matrix. The compiled
cell loops then add to these addresses. They neither search nor store element matrices, which
``MatSetValuesCOO`` needs.
``python -m benchmarks assembly`` compares the time per cell with dolfinx's assembly by
``MatSetValues``, ``python -m benchmarks coo_assembly`` with ``MatSetValuesCOO``.

Contributions to rows of another rank are summed in a separate array and sent to the owner of the
rows once per assembly (`SentRows`). The blocks between nodes that share no cell change from step to
step; ``MatSetValues`` adds them (`fem_snh.assembly.added_couplings`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import aij_blocks
from fem_snh.arrays import Array
from fem_snh.assembly.inclined_planes import InclinedPlanes, MatrixProjection
from fem_snh.assembly.matrix_layout import MatrixLayout, MixedDofMap, Received
from fem_snh.kernels.block_pattern import concatenated_ranges
from fem_snh.kernels.cell_matrices import Addresses, MatrixAddition

if TYPE_CHECKING:
    from fem_snh.assembly.added_couplings import Couplings
    from fem_snh.assembly.elimination import Elimination

#: ``add(array, targets, values)`` adds values at offsets of an array, numbered as in
#: `MatrixLayout.block_positions`.
_Add = Callable[[int, Array, Array], None]


class SentRows:
    """Values in the rows of ghost blocks, which are sent to the owners of the rows. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns.
    layout : MatrixLayout
        The patterns of the sent and of the received rows.

    Attributes
    ----------
    values : (n,) float64
        The values to send, row by row. Cell loops add to them.
    """

    def __init__(self, dof_map: MixedDofMap, layout: MatrixLayout) -> None:
        self._comm, offsets = dof_map.comm, layout.sent.row_offsets
        self.values = np.zeros(int(offsets[-1]))
        owner, lengths = dof_map.owner_ranks(layout.ghosts), np.diff(offsets)
        self._sent = {}
        for rank in np.unique(owner[lengths > 0]):  # length 0: a ghost of no cell of this rank
            rows = owner == rank
            chosen = concatenated_ranges(offsets[:-1][rows], lengths[rows])
            self._sent[int(rank)] = chosen.astype(np.int32)
        self._received = {
            rank: _Addition(dof_map, blocks, layout.row_strides)
            for rank, blocks in enumerate(layout.received)
            if len(blocks.rows)
        }

    def add_to(self, add: _Add) -> None:
        """Send ``values``, and ``add`` received values to a matrix. Collective."""
        requests = [self._comm.Irecv(a.values, source=r) for r, a in self._received.items()]
        messages = {rank: self.values[chosen] for rank, chosen in self._sent.items()}
        requests += [self._comm.Isend(values, dest=rank) for rank, values in messages.items()]
        MPI.Request.Waitall(requests)
        for addition in self._received.values():
            addition.add_to(add)


class _Addition:
    """The receive buffer for one rank's values, and the matrix entries to which they are added."""

    def __init__(self, dof_map: MixedDofMap, blocks: Received, strides: Sequence[Array]) -> None:
        begin = np.flatnonzero(np.diff(blocks.rows, prepend=-1))
        count = np.diff(begin, append=len(blocks.rows))
        size = dof_map.global_dofs(blocks.rows[begin])[1]
        # For each matrix row its blocks, and its number within the block row.
        block = concatenated_ranges(np.repeat(begin, size), np.repeat(count, size))
        number = concatenated_ranges(np.zeros_like(size), size)
        number = np.repeat(number, np.repeat(count, size))
        offset, array = np.divmod(blocks.positions, 4)
        own = np.flatnonzero(dof_map.is_owned)[blocks.rows - dof_map.owned_range[0]]
        stride = np.stack(strides)[array, own]
        first = offset[block] + number * stride[block]
        width = dof_map.global_dofs(blocks.columns)[1][block]
        target, array = concatenated_ranges(first, width), np.repeat(array[block], width)
        array[np.repeat(blocks.positions[block] < 0, width)] = -1  # only the transpose is stored
        self.values = np.empty(len(target))
        chosen = {k: np.flatnonzero(array == k).astype(np.int32) for k in (0, 1, 3)}
        self._parts = {k: (of, target[of].astype(np.int32)) for k, of in chosen.items() if len(of)}

    def add_to(self, add: _Add) -> None:
        """Add the received values to the matrix: see `SentRows.add_to`."""
        for array, (chosen, target) in self._parts.items():
            add(array, target, self.values[chosen])


class BlockMatrix:
    """A matrix with the sparsity pattern of a dof map's cells, AIJ or a `HalfMatrix`. Collective.

    Terms add to the matrix inside of `adding`. Rows and columns of constrained dofs are zero except
    for one positive number on the diagonal, the same for all: the mean absolute diagonal entry of
    the free displacement dofs in the first assembly (1 if the mean is 0).

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns, displacements first.
    constrained : (local nodes, components) bool, optional
        Constrained components of the displacement, ghost nodes included. Default: none.
    layout : MatrixLayout, optional
        The layout of another matrix of ``dof_map``, to share.
    planes : InclinedPlanes, optional
        Nodes with constrained directions that are no coordinate axes. These directions are
        eliminated like constrained dofs.
    unit : float, optional
        As for `MatrixLayout`; without ``planes``, and without `couple` and `eliminate`.

    Attributes
    ----------
    mat : PETSc.Mat
        The matrix.
    layout : MatrixLayout
        The sparsity pattern. `couple` and `eliminate` may replace it by another object.
    constrained_dofs : (n,) int
        The constrained dofs that this rank owns, as indices into a vector's local array.
    block_positions : (cells, n, n) int32
        Where the blocks of each cell are stored: see `fem_snh.assembly.matrix_layout.MatrixLayout`.
        Replaced together with ``layout``.
    row_strides : list of four (local blocks,) int32
        See `MatrixLayout`.
    free : (local nodes, components) float64
        0 for constrained components of the displacement, else 1.
    is_constrained : (cells,) uint8
        1 for each cell with a constrained component, else 0.
    idle : (n,) int
        Owned dofs of pressures whose cells are all rigid and not assembled: rows and columns are
        zero. `adding` sets their diagonal to minus that of constrained dofs. The matrix is then
        regular, and each pressure still has one negative eigenvalue.
    addresses : Addresses
        Where the value arrays are, inside of `adding`.

    Raises
    ------
    BadInput
        On every rank, if a rank has more values than a 32-bit offset can address.
    """

    def __init__(
        self,
        dof_map: MixedDofMap,
        constrained: Array | None = None,
        layout: MatrixLayout | None = None,
        planes: InclinedPlanes | None = None,
        unit: float | None = None,
    ) -> None:
        self._dof_map, self._planes = dof_map, planes
        self._set_layout(layout or MatrixLayout(dof_map, unit=unit))
        if layout is not None:
            self.mat = layout.mat.duplicate()
        self._couplings: Couplings | None = None
        self._elimination: Elimination | None = None
        self.addresses = Addresses()

        if constrained is None:
            constrained = np.zeros((dof_map.num_blocks[0], dof_map.components), dtype=bool)
        num_nodes = dof_map.num_owned_blocks[0]
        self._num_u = dof_map.components * num_nodes
        self.constrained_dofs = np.flatnonzero(constrained[:num_nodes])
        self.idle: Array = np.empty(0, np.int64)
        self.free = np.where(constrained, 0.0, 1.0)
        nodes = dof_map.cell_blocks[:, : dof_map.num_cell_blocks[0]]
        self.is_constrained: Array = np.any(constrained[nodes], axis=(1, 2)).astype(np.uint8)
        self._constrained_diagonal: float | None = None
        self._diagonal_vec: PETSc.Vec | None = None

    @contextmanager
    def adding(self) -> Iterator[None]:
        """Zero the matrix, let terms add to it inside of the context, and assemble it. Collective.

        On exit, rigid parts, inclined planes and constrained dofs are eliminated. Terms may add in
        any order; ranks need not add the same number of element matrices.
        """
        self.mat.zeroEntries()
        self._sent_rows.values[:] = 0
        half = self.layout.half
        with self._open(self._sent_rows.values) as (self.addresses, add):
            try:
                yield
            finally:
                self.addresses = Addresses()
            self._sent_rows.add_to(add)
        if self._couplings:
            self._couplings.set_values(self.mat)
        self.mat.assemble()
        if self._elimination:
            self._elimination.apply(self.mat)
        # Preconditioners compare this counter; writing to the arrays does not increase it.
        self.mat.stateIncrease()
        if self._planes:
            self._projection.apply(self.mat)
        self._add_constrained_diagonal()
        if half:
            half.finish()
            half.update_aij(self.mat)

    @contextmanager
    def _open(self, sent: Array) -> Iterator[tuple[Addresses, _Add]]:
        """Yield where terms add to the matrix, and the function that adds received values."""
        if half := self.layout.half:
            yield half.addresses(sent), half.add
            return
        with aij_blocks(self.mat) as blocks:
            values = [block.array() for block in blocks]

            def add(array: int, targets: Array, received: Array) -> None:
                values[array][targets] += received

            given = [*(block.values for block in blocks), 0][:2]
            yield Addresses([*given, sent.ctypes.data, 0]), add

    def add_matrices(self, cells: Array, matrices: Array) -> None:
        """Add element matrices, inside of `adding`. Not collective.

        Rows and columns of constrained dofs are left out.

        Parameters
        ----------
        cells : (n,) int32
            Cells of this rank; a cell may occur several times, for example once for each facet.
        matrices : (n, k, k)
            The element matrix of each cell [N/m]: all displacement dofs, node by node, then the
            pressure dofs, or the displacement dofs alone.
        """
        self._addition.add(self.addresses, cells, matrices)

    def absolute_product(self, x: PETSc.Vec) -> PETSc.Vec:
        """Return ``|A| x`` with the absolute values of the entries. Collective."""
        product = x.duplicate()
        if self.layout.half:
            product.array[:] = self.layout.half.absolute_product(x)
            return product
        absolute = self.mat.duplicate(copy=True)
        with aij_blocks(absolute) as blocks:
            for block in blocks:
                np.abs(block.array(), out=block.array())
        absolute.mult(x, product)
        absolute.destroy()
        return product

    def couple(self, pairs: Sequence[Array]) -> None:
        """Extend the sparsity pattern if it lacks one of these pairs of nodes. Collective.

        The extended matrix is zero. ``mat`` remains the same object: its
        ``nonzero_state`` changes, and tells solvers to set up again.

        Parameters
        ----------
        pairs : sequence of (n, 2) int64
            Row and column of each block, as global nodes of the displacement's space. Each rank
            gives all pairs in the rows that it owns; pairs in other ranks' rows are ignored.
        """
        if self._couplings is None:
            self._couplings = self._no_couplings()
        if self._couplings.require(pairs):
            self._set_layout(MatrixLayout(self._dof_map, self._couplings.pairs, self.mat))
            self._couple_eliminated()

    def eliminate(self, create: Callable[[MixedDofMap], Elimination]) -> Elimination:
        """Eliminate the nodes of rigid parts in `adding` from now on. Collective.

        ``create(dof_map)`` makes the elimination, which is returned. The sparsity pattern is
        extended by `Elimination.pairs`, and the matrix is then zero.
        """
        self._elimination = create(self._dof_map)
        self._couplings = self._no_couplings()
        self._couple_eliminated()
        return self._elimination

    def _no_couplings(self) -> Couplings:
        from fem_snh.assembly.added_couplings import Couplings

        return Couplings(self._dof_map, self.constrained_dofs)

    def _couple_eliminated(self) -> None:
        """Extend the sparsity pattern by `Elimination.pairs`, if there is an elimination."""
        if self._elimination and self._couplings:
            if self._couplings.require_eliminated(self._elimination.pairs(self.mat)):
                self._set_layout(MatrixLayout(self._dof_map, self._couplings.pairs, self.mat))

    def add_couplings(self, nodes: Array, matrices: Array, others: Array | None = None) -> None:
        """Add matrices of nodes that share no cell, inside of `adding`. Not collective.

        Rows and columns of constrained dofs are left out. The pattern must have the blocks: add
        pairs of nodes that share no cell by `couple` first.

        Parameters
        ----------
        nodes : (n, k) int64
            The nodes of the rows, as global nodes of the displacement's space. Each rank gives all
            matrices with a row that it owns; rows of other ranks are ignored.
        matrices : (n, components * k, components * l)
            The matrices [N/m], numbered node by node.
        others : (n, l) int64, optional
            The nodes of the columns. Default: ``nodes``.

        Raises
        ------
        ValueError
            If neither `couple` nor `eliminate` was called before.
        """
        if self._couplings is None:
            raise ValueError("add_couplings: expected after couple")
        self._couplings.add(nodes, matrices, others)

    def _set_layout(self, layout: MatrixLayout) -> None:
        self.layout, self.mat = layout, layout.mat
        self.block_positions, self.row_strides = layout.block_positions, layout.row_strides
        for name in ("_addition", "_sent_rows", "_projection"):
            self.__dict__.pop(name, None)  # cached for the former pattern

    def without_constraints(self) -> BlockMatrix:
        """Return a zero matrix of this layout without constraints or elimination. Collective."""
        return BlockMatrix(self._dof_map, layout=self.layout)

    def add_node_pairs(
        self, pattern: tuple[Array, Array], positions: Array, factor: float, values: Array
    ) -> None:
        """Add multiples of the identity at pairs of nodes, inside of `adding`. Not collective.

        The parameters are those of `MatrixAddition.add_node_pairs`; ``positions`` are encoded as in
        ``block_positions``.
        """
        self._addition.add_node_pairs(self.addresses, pattern, positions, factor, values)

    @cached_property
    def _sent_rows(self) -> SentRows:
        return SentRows(self._dof_map, self.layout)

    @cached_property
    def _projection(self) -> MatrixProjection:
        assert self._planes
        return MatrixProjection(self.mat, self._dof_map, self._planes)

    @cached_property
    def _addition(self) -> MatrixAddition:
        """The compiled loop of `add_matrices` and `add_node_pairs`, created on first use."""
        blocks, sizes = self._dof_map.cell_blocks, self._dof_map.cell_block_sizes
        return MatrixAddition(blocks, sizes, self.block_positions, self.row_strides, self.free)

    @property
    def constrained_diagonal(self) -> float | None:
        """The diagonal entry of constrained dofs [N/m]; None before the first assembly."""
        return self._constrained_diagonal

    def set_constrained_diagonal(self, value: float | None) -> None:
        """Set the diagonal entry of constrained dofs [N/m] from the next assembly on.

        None: the next assembly computes the entry (see the class).
        """
        self._constrained_diagonal, self._diagonal_vec = value, None

    def _add_constrained_diagonal(self) -> None:
        """Add the diagonal of constrained, eliminated and idle dofs and of planes. Collective.

        The entry is computed if it is not known yet.
        """
        if self._diagonal_vec is None:
            self._diagonal_vec = self.mat.getDiagonal()
            values, constrained = self._diagonal_vec.array, self.constrained_dofs
            if self._elimination:
                constrained = np.union1d(constrained, self._elimination.eliminated)
            if self._constrained_diagonal is None:
                free = np.delete(values[: self._num_u], constrained)
                local = np.array([np.abs(free).sum(), len(free)])
                total, count = self._dof_map.comm.allreduce(local)
                if not np.isfinite(total):  # of crushed cells, in this assembly only
                    self._diagonal_vec = None
                    return
                self._constrained_diagonal = float(total / max(count, 1)) or 1.0
            values[:] = 0.0
            values[constrained] = self._constrained_diagonal
            values[self.idle] = -self._constrained_diagonal
        self.mat.setDiagonal(self._diagonal_vec, addv=PETSc.InsertMode.ADD)
        if self._planes and self._constrained_diagonal:
            self._projection.add_diagonal(self.mat, self._constrained_diagonal)


def create_matrix(
    V: Any,
    Q: Any = None,
    constrained: Array | None = None,
    planes: InclinedPlanes | None = None,
    unit: float | None = None,
) -> BlockMatrix:
    """Return the zero matrix of a displacement space, and of a pressure space if any. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    Q : dolfinx function space, optional
        The pressure's space, if the pressure is an unknown of the problem.
    constrained : (local nodes, components) bool, optional
        As for `BlockMatrix`.
    planes : InclinedPlanes, optional
        As for `BlockMatrix`.
    unit : float, optional
        As for `MatrixLayout`; without ``Q`` and ``planes``.
    """
    dof_map = MixedDofMap([V] if Q is None else [V, Q])
    return BlockMatrix(dof_map, constrained, planes=planes, unit=unit)
