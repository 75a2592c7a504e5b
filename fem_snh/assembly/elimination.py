r"""Elimination of the nodes of rigid parts from an assembled matrix.

The displacement u of the nodes of a rigid part is a function of six unknowns q. With the derivative
:math:`B = \partial u / \partial q`, the rows and columns of the nodes are replaced by :math:`B^T A`
and :math:`A B`. Two nodes of the part, its slots, lend their rows, columns and vector entries to q,
so that the numbering and the blocks of the matrix stay as they are. All other rows and columns of
the part's nodes become those of constrained dofs.

A periodic or other multi-point condition, :math:`u_s = C u_m + g` with unknown displacements of the
nodes m, needs a more general class, with a sparse matrix C in place of six unknowns per part. The
class would go here, with the members that `BlockMatrix` uses (``pairs``, ``apply``,
``eliminated``). A term beside `fem_snh.terms.rigid_parts` would treat the residual and :math:`u_s`.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from fem_snh.arrays import Array
from fem_snh.assembly.matrix_layout import MixedDofMap

Indices = npt.NDArray[np.int64]

#: Unknowns of a rigid part.
UNKNOWNS = 6


class Elimination:
    """The elimination of the nodes of rigid parts with six unknowns each. Collective.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns, displacements first.
    nodes, labels : (n,) int
        The nodes of rigid parts that this rank owns, and the part of each node.
    slots : (parts, 2) int
        The global nodes that lend their entries to the free unknowns of each part, in order.
    free : (6 * parts,) bool
        Which unknowns of the parts are free.
    chains : sequence of sequences of int
        For each part, the parts whose unknowns move this part (by joints), itself included.

    Attributes
    ----------
    eliminated : (m,) int
        The owned dofs of the parts' nodes that store no free unknown.
    unknowns : (6 * parts,) int
        The global dof that stores each unknown; -1 for an unknown that is not free.
    own_unknowns : tuple of two (k,) int
        The owned dofs that store unknowns, as indices into a vector's local array, and the indices
        of these unknowns in ``unknowns``.
    """

    def __init__(
        self,
        dof_map: MixedDofMap,
        nodes: Indices,
        labels: Indices,
        slots: Indices,
        free: Array,
        chains: Sequence[Sequence[int]],
    ) -> None:
        self._dof_map, self._comm = dof_map, dof_map.comm
        self._labels, parts = labels, len(slots)
        size = dof_map.components
        self._rows = (size * nodes[:, None] + np.arange(size)).ravel()
        self._first = self._comm.exscan(dof_map.num_owned_dofs) or 0
        self._own = own = (self._first + self._rows).astype(PETSc.IntType)
        self._slaves = np.sort(np.concatenate(self._comm.allgather(own)))
        self._slot_blocks = dof_map.displacement_blocks(slots.ravel()).reshape(-1, 2)
        starts = dof_map.global_dofs(self._slot_blocks.ravel())[0]
        entries = (starts[:, None] + np.arange(size)).reshape(parts, -1)
        order = np.cumsum(free.reshape(parts, -1), axis=1) - 1
        entries = np.take_along_axis(entries, np.maximum(order, 0), axis=1)
        self.unknowns = np.where(free, entries.ravel(), -1).astype(PETSc.IntType)
        self._free, self._chains, size = free, chains, UNKNOWNS * parts
        self.eliminated = self._rows[~np.isin(own, self.unknowns)]
        which = np.flatnonzero(np.isin(self.unknowns, own))
        self.own_unknowns = self.unknowns[which] - self._first, which
        self.set_state(np.zeros((len(own), UNKNOWNS)), np.eye(size), np.zeros((size, size)))

    def set_state(
        self, basis: Array, jacobian: Array, stiffness: Array, symmetric: bool = True
    ) -> None:
        """Set the derivatives and the stiffness that `apply` uses.

        B is ``basis`` times ``jacobian``.

        Parameters
        ----------
        basis : (components * n, 6) array
            The derivative of the displacement of this rank's nodes by the twist of their part.
        jacobian : (6 * parts, 6 * parts) array
            The derivative of all twists by all unknowns.
        stiffness : (6 * parts, 6 * parts) array
            A matrix to add to the rows and columns of the unknowns, the same on all ranks.
        symmetric : bool
            Whether the assembled matrix is symmetric up to rounding.
        """
        self._basis, self._jacobian, self._stiffness = basis, jacobian, stiffness
        self._symmetric = symmetric

    def pairs(self, mat: PETSc.Mat) -> Indices:
        """Return the pairs of global blocks (n, 2) that `apply` fills in owned rows. Collective.

        Also set the columns that `apply` uses: call this method again if the pattern changes.
        """
        dof_map, parts = self._dof_map, len(self._slot_blocks)
        rows = self._rows_of_parts(mat).tocoo()
        pairs = np.stack([np.repeat(self._labels, dof_map.components)[rows.row], rows.col])
        own = np.unique(pairs.astype(np.int64), axis=1)
        part, columns = np.unique(np.concatenate(self._comm.allgather(own), axis=1), axis=1)
        self._columns = np.unique(columns).astype(PETSc.IntType)
        others = ~np.isin(columns, self._slaves)
        part, neighbours = np.unique(
            np.stack([part[others], dof_map.blocks_of(columns[others])]), axis=1
        )
        chain = [np.array(self._chains[p]) for p in part]
        neighbours = np.repeat(neighbours, [len(c) for c in chain])
        part = np.concatenate([np.empty(0, np.int64), *chain])
        pairs = [np.stack([self._slot_blocks[part, k], neighbours], axis=1) for k in range(2)]
        pairs += [pair[:, ::-1] for pair in pairs]
        slots = self._slot_blocks.ravel()
        pairs.append(np.stack([np.repeat(slots, 2 * parts), np.tile(slots, 2 * parts)], axis=1))
        every = np.concatenate(pairs)
        first, last = dof_map.owned_range
        return every[(every[:, 0] >= first) & (every[:, 0] < last)]

    def apply(self, mat: PETSc.Mat) -> None:
        """Eliminate the parts' nodes from an assembled matrix, in place. Collective.

        The pattern must contain `pairs`. Rows and columns of eliminated dofs become zero, the
        diagonal included.
        """
        rows, square = self._folded(mat)
        columns = rows
        if self._symmetric:
            square = (square + square.T) / 2
        else:
            columns = self._folded(mat.transpose(PETSc.Mat()))[0]  # transpose() is in place
        square = (square + self._stiffness) * np.outer(self._free, self._free)
        free, (entries, own) = self.unknowns >= 0, self.own_unknowns
        others = ~np.isin(self._columns, self._slaves)
        first, last = mat.getOwnershipRange()
        owned = others & (self._columns >= first) & (self._columns < last)
        # The pattern lacks blocks of a part and neighbours of unrelated parts: these are zero.
        mat.setOption(PETSc.Mat.Option.IGNORE_ZERO_ENTRIES, True)
        mat.zeroRowsColumns(self._own, diag=0.0)
        unknowns, own_rows = self.unknowns[free], first + entries
        for at, to, values in (
            (own_rows, self._columns[others], rows[own][:, others]),
            (self._columns[owned], unknowns, columns[free][:, owned].T),
            (own_rows, unknowns, square[own][:, free]),
        ):
            mat.setValues(at, to, np.ascontiguousarray(values))  # petsc4py ignores strides
        mat.assemble()
        mat.setOption(PETSc.Mat.Option.IGNORE_ZERO_ENTRIES, False)

    def _folded(self, mat: PETSc.Mat) -> tuple[Array, Array]:
        """Return B^T A, (6 * parts, columns), and B^T A B, (6 * parts, 6 * parts). Collective.

        The columns are ``self._columns``; rows of unknowns that are not free are zero in B^T A.
        """
        size, G = len(self._jacobian), self._jacobian
        row = np.repeat(np.arange(len(self._own)), UNKNOWNS)
        part = np.repeat(self._labels, self._dof_map.components)
        column = (UNKNOWNS * part[:, None] + np.arange(UNKNOWNS)).ravel()
        B = csr_matrix((self._basis.ravel(), (row, column)), shape=(len(self._own), size))
        own_rows = self._rows_of_parts(mat)[:, self._columns]
        rows = self._comm.allreduce((B.T @ own_rows).toarray())
        square = self._comm.allreduce(rows[:, np.searchsorted(self._columns, self._own)] @ B)
        return (G.T @ rows) * self._free[:, None], G.T @ square @ G

    def _rows_of_parts(self, mat: PETSc.Mat) -> csr_matrix:
        """Return the rows of the parts' nodes that this rank owns, (n, global dofs). Collective."""
        rows = PETSc.IS().createGeneral(self._own, comm=self._comm)
        indptr, indices, values = mat.createSubMatrix(rows).getValuesCSR()
        return csr_matrix((values, indices, indptr), shape=(len(self._own), mat.getSize()[1]))
