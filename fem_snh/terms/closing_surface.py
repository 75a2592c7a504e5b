r"""The closing surface of a surface with an edge: rigid parts, constraints, planes of symmetry.

The edge of a surface consists of pieces that belong to one of its facets only: edges of facets in
three dimensions, their ends in two. Each piece is in one class:

- in a plane of symmetry that does not move: the closing surface lies in the plane and sweeps no
  volume;
- on a rigid part: the closing surface is a lid that moves with the part, a fan of triangles between
  the edge and a point, the apex;
- constrained: the closing surface is a fan, too.

The enclosed volume changes by the volumes that the surface and the fans sweep. The apex of a fan is
in all planes of symmetry in which the fan ends. On a body of revolution lids are discs about the
axis.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.errors import BadInput
from fem_snh.mesh.mesh import centroid
from fem_snh.mesh.mesh import volume as body_volume

#: Largest distance of nodes from their plane over the body's length: a mesh file has 8 digits.
_FLAT = 1e-6
#: Largest entry of a projection that counts as rounding.
_ROUNDING = 1e-9
#: Loads at which prescribed values are examined.
_LOADS = (0.25, 0.5, 1.0)
#: Gauss points in [0, 1] and weights; they are exact for the volume swept on a path: a cubic in t.
PATH = ((0.5 - 12**-0.5, 0.5), (0.5 + 12**-0.5, 0.5))


class NotClosedError(Exception):
    """Raised if nothing closes a piece of the edge; the message says where and why."""


class Edge(NamedTuple):
    """The edge of a surface, the same on all ranks.

    Attributes
    ----------
    pieces : (n, nodes of each) int
        The nodes of each piece from one end to the other, as indices into the arrays below.
    weights : (n,) int
        1 if the surface is left of the piece, seen from outside of the body; in two dimensions if
        the end is left of the outward normal; else -1.
    numbers : (nodes,) int
        The nodes' global numbers.
    X : (nodes, dim)
        The nodes' reference coordinates [m].
    free : (nodes, dim, dim)
        The projections onto the nodes' free directions.
    parts : (nodes,) int
        The rigid part of each node; -1: none.
    moved : (loads, nodes, dim)
        Prescribed displacements [m] at the loads 0.25, 0.5 and 1; 0 on parts.
    """

    pieces: Array
    weights: Array
    numbers: Array
    X: Array
    free: Array
    parts: Array
    moved: Array


class Lid(NamedTuple):
    """The integrals of the normal N, and of its moment, over a fan at rest.

    Attributes
    ----------
    apex : (dim,)
        The apex [m].
    area : (dim,)
        The vector area [m^2], the integral of N.
    moment : (dim, dim)
        The integral of N (Y - apex)^T [m^3].
    """

    apex: Array
    area: Array
    moment: Array


class Fan(NamedTuple):
    """A fan between pieces of an edge and its apex.

    Attributes
    ----------
    pieces, weights : arrays
        The pieces of the edge: see `Edge`.
    planes : (m, dim + 1)
        The planes n . x = d that contain the apex, as rows (n, d).
    """

    pieces: Array
    weights: Array
    planes: Array

    def arms(self, x: Array) -> tuple[Array, Array]:
        """Return the apex (dim,) and the pieces' nodes relative to it, (n, nodes of each, dim).

        The edge's nodes are at ``x`` (nodes, dim).
        """
        apex = _project(x[np.unique(self.pieces)].mean(axis=0), self.planes)
        return apex, x[self.pieces] - apex

    def normals(self, arms: Array) -> tuple[Array, Array]:
        """Return quadrature points on the edge and weighted normals there, (n, points, dim) each.

        The sum of the normals over dim - 1 is the vector area. Points are relative to the apex.
        """
        weights = self.weights[:, None]
        if arms.shape[2] == 2:
            return arms, -weights[:, :, None] * np.stack([arms[..., 1], -arms[..., 0]], axis=-1)
        degree = arms.shape[1] - 1
        points, factors = np.polynomial.legendre.leggauss((3 * degree + 1) // 2)
        table = _dolfinx.tabulate_element("interval", degree, (points[:, None] + 1) / 2, 1)
        # Ends come first in the element's order, last in that of pieces.
        order = [0, degree, *range(1, degree)]
        at, along = np.einsum("dqk,nkc->dnqc", table, arms[:, order])
        return at, -np.cross(at, along) * (weights * factors / 2)[:, :, None]

    def lid(self, x: Array) -> Lid:
        """Return the integrals over the fan with the edge's nodes at ``x`` (nodes, dim)."""
        apex, arms = self.arms(x)
        (at, normals), dim = self.normals(arms), len(apex)
        moment = np.einsum("nqi,nqj->ij", normals, at) / dim
        return Lid(apex, normals.sum(axis=(0, 1)) / (dim - 1), moment)

    def swept(self, start: Array, end: Array) -> float:
        """Return the volume [m^3] that the fan sweeps as nodes move straight from start to end."""
        (a, first), (b, last) = self.arms(start), self.arms(end)
        velocity, total, dim = self.normals(last - first)[0], 0.0, len(a)
        for t, weight in PATH:
            normals = self.normals(first + t * (last - first))[1]
            of_apex = float(normals.sum(axis=(0, 1)) @ (b - a)) / (dim - 1)
            total += weight * (of_apex + float((normals * velocity).sum()) / dim)
        return total


class ClosingSurface:
    """The closing surface of a surface of the body. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    facets : (n,) int
        This rank's facets of the surface.
    dirichlet : Dirichlet
        The constrained nodes, and the nodes of rigid parts.
    kinematics : Kinematics, optional
        How the displacement becomes a deformation gradient.

    Attributes
    ----------
    parts : (local nodes,) int
        The rigid part of each node; -1: none.
    lids : dict of int to Lid
        The fans of rigid parts at rest, by the part's number.

    Raises
    ------
    NotClosedError
        On every rank, if a piece of the edge is in no class, or if planes do not close a fan.
    """

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        facets: Array,
        dirichlet: Dirichlet,
        kinematics: Kinematics = SOLID,
    ) -> None:
        self._V, self._dim, self._revolved = V, kinematics.dim, kinematics.revolved
        self._length = body_volume(V.mesh) ** (1 / kinematics.dim)
        self._edge = edge = edge_of(V, facets, dirichlet, kinematics.dim)
        self._centre = centroid(V.mesh, self._dim - 1, facets)[: self._dim]
        self._motions = dirichlet.part_motions
        none = np.full(len(dirichlet.constrained), -1)
        self.parts = none if dirichlet.rigid_parts is None else dirichlet.rigid_parts
        self._planes, self._inside = np.empty((0, self._dim + 1)), np.empty((0, len(edge.X)), bool)
        self.lids: dict[int, Lid] = {}
        self._fans: list[Fan] = []
        #: Constrained nodes of the edge that no fan closes, and which must therefore not move.
        self._at_rest: Array = np.empty(0, np.int64)
        parts = edge.parts[edge.pieces]
        on_part = (parts == parts[:, :1]).all(axis=1) & (parts[:, 0] >= 0)
        of_parts = [
            np.flatnonzero(on_part & (parts[:, 0] == i)) for i in range(parts.max(initial=-1) + 1)
        ]
        if self._revolved:
            self._check_ends(~on_part)
            for part, which in enumerate(of_parts):
                squares = edge.X[edge.pieces[which, 0], 0] ** 2
                area = np.array([0.0, np.pi * (edge.weights[which] * squares).sum()])
                if len(which):
                    self.lids[part] = Lid(np.zeros(2), area, np.zeros((2, 2)))
            return
        slides = (abs(edge.free).max(axis=(1, 2), initial=0.0) > _ROUNDING) & (edge.parts < 0)
        fixed = (parts < 0).all(axis=1) & ~slides[edge.pieces].any(axis=1)
        self._find_planes(slides)
        inside = self._inside[:, edge.pieces].all(axis=2).any(axis=0)
        for piece in np.flatnonzero(~(inside | on_part | fixed)):
            raise self._error(
                piece, "its edge is free, between parts or supports, or leaves its plane"
            )
        for part, which in enumerate(of_parts):
            if len(which := which[~inside[which]]):
                self._fans.append(fan := self._fan(which, part))
                self.lids[part] = fan.lid(edge.X)
        for which in self._connected(np.flatnonzero(fixed & ~inside)):
            try:
                self._fans.append(self._fan(which))
            except NotClosedError:
                if edge.moved[:, edge.pieces[which]].any():
                    raise
                self._at_rest = np.union1d(self._at_rest, edge.pieces[which])

    def _error(self, piece: int, why: str) -> NotClosedError:
        at = self._edge.X[self._edge.pieces[piece]].mean(axis=0)
        return NotClosedError(f"{why} at ({', '.join(f'{x:.6g}' for x in at)})")

    def _check_ends(self, others: Array) -> None:
        """Raise NotClosedError for an end in ``others`` off the axis that is free along it."""
        edge = self._edge
        nodes = edge.pieces[:, 0]
        along = abs(edge.free[nodes, 1]).max(axis=1, initial=0.0) > _ROUNDING
        off_axis = abs(edge.X[nodes, 0]) > _FLAT * self._length
        for piece in np.flatnonzero(others & off_axis & along):
            raise self._error(piece, "its edge is free")

    def _find_planes(self, slides: Array) -> None:
        """Set ``_planes``, in which nodes slide, and ``_inside``, (planes, nodes) bool.

        ``slides`` (nodes,) bool marks nodes of no part with a free direction.
        """
        edge = self._edge
        points, length = edge.X[edge.pieces], self._length
        t = (points[:, 1:] - points[:, :1]) / length
        t /= np.linalg.norm(t, axis=2).max(axis=1, initial=_ROUNDING)[:, None, None]
        free = (edge.free * slides[:, None, None])[edge.pieces].sum(axis=1)
        values, vectors = np.linalg.eigh(free + t.swapaxes(1, 2) @ t)
        # The plane of a piece on two planes, or of constrained nodes, is not determined.
        known = slides[edge.pieces].any(axis=1) & (values[:, 0] <= _FLAT**2)
        known &= values[:, 1] > _FLAT**2
        normals = vectors[known, :, 0]
        largest = np.take_along_axis(normals, abs(normals).argmax(axis=1)[:, None], axis=1)
        normals *= np.sign(largest)
        offsets = (points[known].mean(axis=1) * normals).sum(axis=1)
        planes = np.column_stack([normals, offsets])
        digits = np.round(planes / _FLAT / np.append(np.ones(self._dim), length))
        self._planes = planes[np.unique(digits, axis=0, return_index=True)[1]]
        at_loads = np.concatenate([edge.X[None], edge.X + edge.moved])
        normal, offset = self._planes[:, :-1], self._planes[:, -1]
        away = abs(at_loads @ normal.T - offset).max(axis=0).T > _FLAT * length
        leaves = abs(edge.free @ normal.T).max(axis=1, initial=0.0).T > _FLAT
        kept = np.array([self._keeps(part) for part in range(edge.parts.max(initial=-1) + 1)])
        on_part = np.flatnonzero(edge.parts >= 0)
        leaves[:, on_part] = ~kept[edge.parts[on_part]].T if len(on_part) else True
        self._inside = ~(away | leaves)

    def _keeps(self, part: int) -> Array:
        """Return for each plane whether a part's motions keep it in place, (planes,) bool."""
        kept = np.ones(len(self._planes), dtype=bool)
        normals = np.zeros((len(kept), 3))
        normals[:, : self._dim] = self._planes[:, :-1]
        through = normals * self._planes[:, -1:]
        for velocity, omega in self._motions[part]:
            along = (normals * (velocity + np.cross(omega, through))).sum(axis=1)
            turns = np.linalg.norm(np.cross(normals, omega), axis=1) * self._length
            size = np.linalg.norm(velocity) + np.linalg.norm(omega) * self._length
            kept &= np.maximum(abs(along), turns) <= _FLAT * size
        return kept

    def _connected(self, pieces: Array) -> list[Array]:
        """Return the connected sets of pieces; in two dimensions, of ends that move alike."""
        nodes = self._edge.pieces[pieces]
        if self._dim == 2:
            moved = (
                self._edge.moved[:, nodes[:, 0]]
                .swapaxes(0, 1)
                .reshape(len(pieces), self._dim * len(_LOADS))
            )
            digits = np.round(moved / (_FLAT * self._length))
            labels = np.unique(digits, axis=0, return_inverse=True)[1].ravel()
            return [pieces[labels == i] for i in np.unique(labels)]
        rows = np.repeat(np.arange(len(pieces)), nodes.shape[1])
        shape = (len(pieces), len(self._edge.X))
        touching = coo_array((np.ones(nodes.size), (rows, nodes.ravel())), shape).tocsr()
        count, labels = connected_components(touching @ touching.T, directed=False)
        return [pieces[labels == i] for i in range(count)]

    def _fan(self, which: Array, part: int = -1) -> Fan:
        """Return the fan of the pieces ``which``, on a rigid part, or constrained if part = -1.

        Raises
        ------
        NotClosedError
            If the pieces end in no plane, or in planes that leave the fan open.
        """
        edge, planes = self._edge, self._planes
        pieces, weights = edge.pieces[which], edge.weights[which]
        net = np.zeros(len(edge.X), dtype=int)
        np.add.at(net, pieces[:, -1], weights)
        if self._dim == 3:
            np.add.at(net, pieces[:, 0], -weights)
            ends_in = self._inside[:, net != 0]
            is_open, around = not ends_in.any(axis=0).all(), planes[ends_in.any(axis=1)]
        elif net.sum():  # a line from an end to all planes
            stays = part < 0 or self._keeps(part).all()
            is_open, around = not (len(planes) and stays), planes
        else:  # a line between two ends
            is_open, around = part < 0 and len(which) > 2, planes[:0]
        found = Fan(pieces, weights, around)
        distances = around[:, :-1] @ found.arms(edge.X)[0] - around[:, -1]
        if is_open or abs(distances).max(initial=0.0) > _FLAT * self._length:
            raise self._error(which[0], "its edge ends in planes that leave it open")
        return found

    def facets_of_part(self, part: int, others: Array) -> Array:
        """Return this rank's facets of the boundary on a part that are not in ``others``, (n,)."""
        V = self._V
        facets, cells, local = _dolfinx.exterior_facets(V.mesh)
        nodes = _dolfinx.node_dofs(V)[cells[:, None], _dolfinx.facet_nodes(V)[local]]
        return facets[(self.parts[nodes] == part).all(axis=1) & ~np.isin(facets, others)]

    def collapse(self) -> tuple[Array, Array, float] | None:
        """Return affine displacements K (o - X) that collapse the volume to 0 and keep all planes.

        Returns
        -------
        K : (dim, dim)
            The matrix. The whole result is None if no such displacements are known.
        o : (dim,)
            The point [m].
        swept : float
            The volume that the fans sweep in these displacements [m^3].
        """
        X = self._edge.X
        if self._revolved:
            K, point = np.diag([1.0, 0.0]), np.zeros(2)
            return K, point, self._swept((point - X) @ K)
        normals, offsets = self._planes[:, :-1], self._planes[:, -1]
        point = _project(self._centre, self._planes)
        away = normals[abs(normals @ point - offsets) > _FLAT * self._length]
        K = np.eye(self._dim) - np.linalg.pinv(away, rcond=_FLAT) @ away
        kept = normals @ K
        tilted = abs(kept - (kept * normals).sum(axis=1)[:, None] * normals).max(initial=0.0)
        if len(self._at_rest) or tilted > _FLAT or not K.any():
            return None
        return K, point, self._swept((point - X) @ K)

    def swept(self, u: PETSc.Vec) -> float:
        """Return the volume [m^3] that the fans sweep from rest to ``u``. Collective."""
        return self._swept(_gather(self._V, u.array_r, self._edge.numbers))

    def _swept(self, moved: Array) -> float:
        """Return the volume [m^3] that the fans sweep up to displacements of the edge's nodes.

        ``moved`` is (nodes, components).

        Raises
        ------
        BadInput
            If constrained nodes that no fan closes move, by values that a program changes.
        """
        X = self._edge.X
        if self._revolved:
            nodes, total = self._edge.pieces[:, 0], 0.0
            for t, weight in PATH:
                squares = (X[nodes, 0] + t * moved[nodes, 0]) ** 2
                squares += (t * moved[nodes, 2:]).sum(axis=1) ** 2
                total += weight * np.pi * float(self._edge.weights * squares @ moved[nodes, 1])
            return total
        if abs(moved[self._at_rest]).max(initial=0.0) > _FLAT * self._length:
            raise BadInput("the constrained edge of a surface moves and leaves it open")
        return sum(fan.swept(X, X + moved[:, : self._dim]) for fan in self._fans)


def _project(point: Array, planes: Array) -> Array:
    """Return the nearest point in all planes; in least squares, if the planes do not meet."""
    distances: Array = planes[:, -1] - planes[:, :-1] @ point
    return np.asarray(point + np.linalg.lstsq(planes[:, :-1], distances, rcond=_FLAT)[0])


def edge_of(V: _dolfinx.FunctionSpace, facets: Array, dirichlet: Dirichlet, dim: int) -> Edge:
    """Return the edge of a surface with this rank's ``facets``. Collective."""
    pieces, weights = _pieces_of_facets(V, facets)
    to_global, components = _dolfinx.local_to_global(V), _dolfinx.num_components(V)
    pieces, weights = _sum_weights([to_global[pieces]], [weights])
    comm = V.mesh.comm
    pieces, weights = _sum_weights(*zip(*comm.allgather((pieces, weights)), strict=True))
    numbers, rows = np.unique(pieces, return_inverse=True)
    owned = _dolfinx.num_nodes(V)[0]
    free = np.eye(components) * ~dirichlet.constrained[:owned, None]
    if dirichlet.planes:
        count = dirichlet.planes.num_owned
        free[dirichlet.planes.nodes[:count]] = dirichlet.planes.projections[:count]
    parts = dirichlet.rigid_parts
    columns = [
        V.tabulate_dof_coordinates()[:owned, :dim],
        free[:, :dim, :dim].reshape(owned, dim**2),
        np.full((owned, 1), -1) if parts is None else parts[:owned, None],
    ]
    for load in _LOADS:
        u = _dolfinx.create_vector(V)
        dirichlet.set_values(u, load)
        columns.append(u.array_r.reshape(owned, components)[:, :dim])
    table = _gather(V, np.hstack(columns), numbers)
    X, free, parts, moved = np.split(table, np.cumsum([dim, dim**2, 1]), axis=1)
    moved = np.where(parts < 0, moved, 0.0)
    return Edge(
        rows.reshape(pieces.shape),
        weights,
        numbers,
        X,
        free.reshape(-1, dim, dim),
        parts[:, 0].round().astype(int),
        moved.reshape(-1, len(_LOADS), dim).swapaxes(0, 1),
    )


def _gather(V: _dolfinx.FunctionSpace, values: Array, numbers: Array) -> Array:
    """Return rows of values of the nodes with these global numbers, on every rank. Collective.

    ``values`` has a row for each owned node, or is flat, (owned dofs,).
    """
    if values.ndim == 1:
        values = values.reshape(-1, _dolfinx.num_components(V))
    local = numbers - _dolfinx.local_to_global(V)[0] if len(values) else numbers * 0 - 1
    mine = (local >= 0) & (local < len(values))
    found = np.zeros((len(numbers), values.shape[1]))
    found[mine] = values[local[mine]]
    return np.asarray(V.mesh.comm.allreduce(found))


def _pieces_of_facets(V: _dolfinx.FunctionSpace, facets: Array) -> tuple[Array, Array]:
    """Return the pieces of all of this rank's facets, local nodes, and weights, as in `Edge`."""
    domain = V.mesh
    cell, dim, degree = _dolfinx.cell_name(domain), domain.topology.dim, _dolfinx.degree(V)
    exterior, cells, local = _dolfinx.exterior_facets(domain)
    chosen = np.isin(exterior, facets)
    nodes, local = _dolfinx.node_dofs(V)[cells[chosen]], local[chosen]
    X = V.tabulate_dof_coordinates()[:, :dim]
    points, corners = _dolfinx.reference_nodes(cell, degree), _dolfinx.reference_corners(cell)
    ends = _dolfinx.reference_edges(cell) if dim == 3 else np.arange(len(corners))[:, None]
    pieces, weights = [np.empty((0, degree + 1 if dim == 3 else 1), int)], [np.empty(0, int)]
    for number, facet in enumerate(_dolfinx.reference_facets(cell)):
        own = nodes[local == number]
        outward = X[own[:, facet]].mean(axis=1) - X[own[:, : len(corners)]].mean(axis=1)
        for piece in ends[np.isin(ends, facet).all(axis=1)]:
            start, end = corners[piece[0]], corners[piece[-1]]
            if dim == 3:
                along, arms = end - start, points - start
                s = arms @ along / (along @ along)
                off = np.linalg.norm(arms - s[:, None] * along, axis=1)
                line = np.flatnonzero(off <= _FLAT)
                line = line[np.argsort(s[line])]
                t = X[own[:, piece[1]]] - X[own[:, piece[0]]]
                inward = X[own[:, facet]].mean(axis=1) - X[own[:, piece[0]]]
                side = np.einsum("ni,ni->n", np.cross(t, inward), outward)
            else:
                line = piece
                t = X[own[:, piece[0]]] - X[own[:, facet]].mean(axis=1)
                side = t[:, 1] * outward[:, 0] - t[:, 0] * outward[:, 1]
            pieces.append(own[:, line])
            weights.append(np.where(side > 0, 1, -1))
    return np.concatenate(pieces), np.concatenate(weights)


def _sum_weights(pieces: Sequence[Array], weights: Sequence[Array]) -> tuple[Array, Array]:
    """Return the distinct pieces whose sum of weights is not zero, and these sums.

    Each piece begins at its lower node number.
    """
    every, weight = np.concatenate(pieces), np.concatenate(weights)
    if every.shape[1] > 1:
        backward = every[:, 0] > every[:, -1]
        every[backward] = every[backward, ::-1]
        weight = np.where(backward, -weight, weight)
    every, which = np.unique(every, axis=0, return_inverse=True)
    sums = np.bincount(which.ravel(), weight, minlength=len(every)).round().astype(int)
    return every[sums != 0], sums[sums != 0]
