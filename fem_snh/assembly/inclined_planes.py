r"""Nodes that slide in planes: the normal component of their displacement is constrained.

A plane whose normal is a coordinate axis constrains a component. Any other plane constrains, at its
nodes, a direction that is no component. Let the columns of B be an orthonormal basis of the
directions that the inclined planes of a node constrain, and
:math:`P = I - B B^T - \sum_i e_i e_i^T` with the node's constrained components i. The force f of a
node, the block of nodes i and j and a rigid motion v are replaced by

.. math:: P f, \qquad P_i A_{ij} P_j + \delta_{ij} d B_i B_i^T, \qquad P v,

with the diagonal entry d of constrained components. These are, in Cartesian components, the entries
that the elimination of a component in a rotated frame gives. The matrix stays symmetric, and is
positive definite if it is so on the free directions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import aij_blocks
from fem_snh.arrays import Array
from fem_snh.assembly.matrix_layout import MixedDofMap

#: Sine of the angle below which a plane's normal is an axis, or two normals are the same: a mesh
#: file has at least 8 digits.
_SAME_DIRECTION = 1e-7
#: Largest distance of nodes from their plane over the nodes' extent: a mesh file's digits.
_FLAT = 1e-6


class NodePlane(NamedTuple):
    """A plane in which nodes slide.

    Attributes
    ----------
    nodes : (n,) int
        The local nodes, ghosts included.
    normal : (components,)
        The plane's unit normal.
    """

    nodes: Array
    normal: Array


class InclinedPlanes:
    """The nodes with a constrained direction that is no component.

    Attributes
    ----------
    nodes : (n,) int
        The local nodes, ghosts included, ascending.
    num_owned : int
        How many of ``nodes`` this rank owns: the first ones.
    projections : (n, components, components)
        The projections P onto free directions.
    bases : (n, components, components)
        The projections :math:`B B^T`.
    prescriptions : (n, components, components)
        Matrices that move a displacement into the planes; they keep its constrained components.
    """

    def __init__(
        self, nodes: Array, num_owned: int, projections: Array, bases: Array, prescriptions: Array
    ) -> None:
        self.nodes, self.num_owned, self.projections = nodes, num_owned, projections
        self.bases, self.prescriptions = bases, prescriptions

    @classmethod
    def of(
        cls, planes: Sequence[NodePlane], constrained: Array, num_owned_nodes: int
    ) -> InclinedPlanes | None:
        """Return the inclined planes among ``planes``; None if there is none on any rank.

        Parameters
        ----------
        planes : sequence of NodePlane
            All planes, the same on all ranks, each with this rank's nodes.
        constrained : (local nodes, components) bool
            The constrained components of nodes, ghosts included. Components that planes constrain,
            alone or together, are set to True in place.
        num_owned_nodes : int
            Number of nodes that this rank owns.
        """
        inclined = []
        for plane in planes:
            axis = int(np.abs(plane.normal).argmax())
            if np.linalg.norm(np.delete(plane.normal, axis)) < _SAME_DIRECTION:
                constrained[plane.nodes, axis] = True
            else:
                inclined.append(plane)
        if not inclined:
            return None
        nodes = np.unique(np.concatenate([plane.nodes for plane in inclined]))
        size = constrained.shape[1]
        rows = np.zeros((len(nodes), len(inclined), size))
        for number, plane in enumerate(inclined):
            rows[np.searchsorted(nodes, plane.nodes), number] = plane.normal
        free = ~constrained[nodes]
        # The planes of a node act on its free components: sum_free n_i u_i = - sum_given n_i u_i.
        U, values, W = np.linalg.svd(rows * free[:, None], full_matrices=False)
        kept = values > _SAME_DIRECTION
        inverses = np.einsum(
            "nkj,nk,nik->nji", W, np.where(kept, 1 / np.where(kept, values, 1), 0), U
        )
        bases = np.einsum("nki,nk,nkj->nij", W, kept.astype(float), W)
        units = np.eye(size)
        projections = units * free[:, None] - bases
        given = -np.einsum("nik,nkj->nij", inverses, rows * ~free[:, None])
        prescriptions = projections + given + units * ~free[:, None]
        # A component that the planes of a node constrain together is one of `constrained`.
        whole = free & (np.abs(projections).max(axis=2) < _SAME_DIRECTION)
        constrained[nodes] |= whole
        projections[whole], bases[whole] = 0.0, 0.0
        bases.swapaxes(1, 2)[whole] = projections.swapaxes(1, 2)[whole] = 0.0
        owned = int(np.searchsorted(nodes, num_owned_nodes))
        return cls(nodes, owned, projections, bases, prescriptions)

    def project(self, values: Array, ghosts: bool = False) -> None:
        """Project displacements or forces onto the free directions of ``nodes``, in place.

        ``values`` begins with the components of the owned nodes; with ``ghosts``, of all local
        nodes.
        """
        self._apply(self.projections, values, None if ghosts else self.num_owned)

    def prescribe(self, values: Array) -> None:
        """Move the displacements of the owned nodes into the planes, in place.

        Constrained components must have their prescribed values, and keep them.
        """
        self._apply(self.prescriptions, values, self.num_owned)

    def work(self, forces: Array, moved: Array) -> float:
        """Return the work [J] of forces on owned nodes along the planes' constrained directions.

        ``forces`` [N] and ``moved`` [m] begin with the components of the owned nodes.
        """
        dofs = self._dofs(self.num_owned)
        return float(np.einsum("nij,ni,nj->", self.bases[: len(dofs)], forces[dofs], moved[dofs]))

    def _apply(self, maps: Array, values: Array, count: int | None) -> None:
        """Replace the values of each of the first ``count`` nodes by its map times the values."""
        dofs = self._dofs(count)
        values[dofs] = np.einsum("nij,nj->ni", maps[:count], values[dofs])

    def _dofs(self, count: int | None) -> Array:
        """Return the local dofs of the first ``count`` nodes (None: all), (count, components)."""
        size = self.projections.shape[-1]
        return size * self.nodes[:count, None] + np.arange(size)

    def free_directions(self) -> tuple[Array, Array]:
        """Return orthonormal free directions at the owned nodes, and the dofs of these nodes.

        Both are (n, components); a node may have several rows, or none.
        """
        values, vectors = np.linalg.eigh(self.projections[: self.num_owned])
        node, number = np.nonzero(values > 0.5)  # a projection has the eigenvalues 0 and 1
        return vectors[node, :, number], self._dofs(self.num_owned)[node]


class MatrixProjection:
    """The elimination of inclined planes from an assembled matrix. Collective.

    Parameters
    ----------
    mat : PETSc.Mat
        A matrix with the AIJ pattern of the matrices to which the methods are applied.
    dof_map : MixedDofMap
        The numbering of the unknowns, displacements first.
    planes : InclinedPlanes
        The nodes with their projections.
    """

    def __init__(self, mat: PETSc.Mat, dof_map: MixedDofMap, planes: InclinedPlanes) -> None:
        self._size, own = dof_map.components, planes.num_owned
        self._own, self._bases = planes.projections[:own], planes.bases[:own]
        nodes, comm = planes.nodes[:own], dof_map.comm
        first = mat.getOwnershipRange()[0] + self._size * nodes
        # Columns of this rank's rows may belong to nodes of no cell of this rank.
        starts, P = (np.concatenate(part) for part in zip(*comm.allgather((first, self._own))))
        self._all = P
        begin, end = mat.getOwnershipRange()
        self._rows: list[tuple[Array, Array]] = []
        self._columns: list[tuple[Array, Array]] = []
        with aij_blocks(mat, read_only=True) as blocks:
            for k, block in enumerate(blocks):
                indptr, indices = block.csr()
                self._rows.append(_row_entries(indptr, self._size * nodes, self._size))
                if k == 0:
                    inside = np.flatnonzero((starts >= begin) & (starts < end))
                    column_of = starts[inside] - begin
                    width = end - begin
                else:
                    width = len(block.ghosts)
                    at = np.searchsorted(block.ghosts, starts)
                    known = at < width
                    known[known] = block.ghosts[at[known]] == starts[known]
                    inside, column_of = np.flatnonzero(known), at[known]
                node_of = np.full(width, -1)
                node_of[column_of] = inside
                entries = np.flatnonzero(node_of[indices] >= 0)
                self._columns.append((entries, node_of[indices[entries]]))
                if k == 0:
                    rows, number = self._rows[0]
                    self._diagonal = rows[:, indices[rows[0]] == self._size * nodes[number]].T

    def apply(self, mat: PETSc.Mat) -> None:
        """Replace each block A_ij by P_i A_ij P_j, with P = I at nodes in no inclined plane."""
        components = np.arange(self._size)
        with aij_blocks(mat) as blocks:
            for block, rows, columns in zip(blocks, self._rows, self._columns, strict=True):
                values = block.array()
                entries, number = rows
                values[entries] = np.einsum("nab,bn->an", self._own[number], values[entries])
                entries, number = columns
                at = entries[:, None] + components
                values[at] = np.einsum("na,nab->nb", values[at], self._all[number])

    def add_diagonal(self, mat: PETSc.Mat, factor: float) -> None:
        """Add ``factor`` times B B^T to the diagonal blocks of the planes' owned nodes."""
        at = self._diagonal[:, :, None] + np.arange(self._size)
        with aij_blocks(mat) as blocks:
            blocks[0].array()[at] += factor * self._bases


def _row_entries(indptr: Array, first_rows: Array, size: int) -> tuple[Array, Array]:
    """Return where an AIJ value array holds the ``size`` rows of each node.

    The rows of a node have the same columns.

    Returns
    -------
    entries : (size, n)
        Indices of values: entries [:, k] are the ``size`` rows of one column.
    number : (n,)
        The node of each k, as an index into ``first_rows``.
    """
    lengths = indptr[first_rows + 1] - indptr[first_rows]
    number = np.repeat(np.arange(len(first_rows)), lengths)
    within = np.arange(len(number)) - np.repeat(np.cumsum(lengths) - lengths, lengths)
    starts = np.stack([indptr[first_rows + a] for a in range(size)])
    return starts[:, number] + within, number


def plane_through(comm: MPI.Intracomm, points: Array) -> Array | None:
    """Return the unit normal of the plane or line through the points of all ranks. Collective.

    ``points`` are this rank's, (n, dim). The normal's largest component is positive. None without a
    common plane or line.
    """
    total, count = comm.allreduce(points.sum(axis=0)), comm.allreduce(len(points))
    from_mean = points - total / max(count, 1)
    _, directions = np.linalg.eigh(comm.allreduce(from_mean.T @ from_mean))
    normal = directions[:, 0] * np.sign(directions[np.abs(directions[:, 0]).argmax(), 0])
    sizes = np.array(
        [np.abs(from_mean @ normal).max(initial=0.0), np.abs(from_mean).max(initial=0.0)]
    )
    comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
    return normal if sizes[0] <= _FLAT * sizes[1] else None
