r"""What closes a surface with an edge: constrained nodes, rigid parts, planes of symmetry.

The edge of a surface is what belongs to one of its facets only. Each piece of it, in three
dimensions the edge of a facet and in two its end, is in one class:

- on a rigid part, which carries a lid: a fan of triangles between the edge and a point of the part;
- constrained: the closing surface is such a fan of the prescribed nodes;
- in a plane of symmetry, which is part of the closing surface.

The enclosed volume is the flux of an affine field f of divergence 1 through the surface, the lids
and the fans, where :math:`f \cdot n = 0` in each plane (`fem_snh.terms.swept_volume`). Where a lid
meets a plane, its fan's point is in that plane; the fluxes of two such fans differ by a constant.
On a body of revolution lids and planes are discs without a flux.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.errors import BadInput
from fem_snh.mesh.mesh import volume as body_volume

Array = npt.NDArray[Any]

#: Largest distance of a plane's nodes from it over the body's length: a mesh file has 8 digits.
_FLAT = 1e-6
#: Largest residual of the equations of a field that is rounding: its parameters are of order 1.
_ROUNDING = 1e-9
#: Loads at which prescribed values are examined.
_LOADS = (0.25, 0.5, 1.0)


class NotClosedError(Exception):
    """Nothing closes a piece of the edge; the message says where and why."""


class Edge(NamedTuple):
    """The edge of a surface, the same on all ranks.

    Attributes
    ----------
    pieces : (n, nodes of each) int
        Its pieces: rows of the other arrays, from one end to the other.
    weights : (n,) int
        1 if the surface is to the left of a piece, seen along its normal, -1 if to the right.
    numbers : (nodes,) int
        The nodes' global numbers.
    X : (nodes, dim)
        Their reference coordinates [m].
    free : (nodes, dim, dim)
        The projections onto their free directions.
    parts : (nodes,) int
        The rigid part of each; -1: none.
    moved : (loads, nodes, dim)
        Prescribed displacements [m] at some loads.
    """

    pieces: Array
    weights: Array
    numbers: Array
    X: Array
    free: Array
    parts: Array
    moved: Array

    @property
    def on_parts(self) -> Array:
        """(n,) bool: which pieces are on one rigid part."""
        parts = self.parts[self.pieces]
        return np.asarray((parts == parts[:, :1]).all(axis=1) & (parts[:, 0] >= 0))


@dataclass(frozen=True, eq=False)
class EdgePlane:
    """A plane of symmetry, normal . X = offset, and whether it moves along its normal."""

    normal: Array
    offset: float
    moves: bool


class Fan(NamedTuple):
    """A fan between a part of an edge and a point, by the sums of its normals and moments.

    Attributes
    ----------
    apex : (dim,)
        The point.
    area : (dim,)
        The vector area a [m^2].
    moment : (dim, dim)
        The integral of N (y - apex)^T.
    """

    apex: Array
    area: Array
    moment: Array


class ClosingSurface:
    """The closing surface of a surface of the body. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    facets : (n,) int
        This rank's facets of the surface.
    dirichlet : Dirichlet
        The constrained nodes and those of rigid parts.
    kinematics : Kinematics, optional
        How the displacement becomes a deformation gradient.

    Attributes
    ----------
    planes : list of EdgePlane
        The planes of symmetry.
    parts : (local nodes,) int
        Which rigid part has each node, -1: none.
    lids : dict of int to Fan
        The fans of rigid parts, by the part's number.
    volume_is_known : bool
        Whether the flux through all fans is known. Those of nodes at rest do not change it.

    Raises
    ------
    NotClosedError
        On every rank, if a piece of the edge is in no class, or in more than one.
    """

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        facets: Array,
        dirichlet: Dirichlet,
        kinematics: Kinematics = SOLID,
    ) -> None:
        self._V, self._dim = V, kinematics.dim
        self._length = body_volume(V.mesh) ** (1 / kinematics.dim)
        self._edge = edge = edge_of(V, facets, dirichlet, kinematics.dim)
        self._dirichlet = dirichlet
        none = np.full(len(dirichlet.constrained), -1)
        self.parts = none if dirichlet.rigid_parts is None else dirichlet.rigid_parts
        self.planes: list[EdgePlane] = []
        self.lids: dict[int, Fan] = {}
        self.volume_is_known = True
        #: Pieces between nodes with prescribed displacements, of each connected part.
        self._fixed: list[Array] = []
        #: Nodes that no such part closes, which must stay at rest.
        self._at_rest: Array = np.empty(0, np.int64)
        parts, on_part = edge.parts[edge.pieces], edge.on_parts
        numbers = np.unique(parts[on_part, 0]).tolist()
        if kinematics.revolved:
            self._check_ends(np.flatnonzero(~on_part))
            for number in numbers:  # horizontal discs
                which = np.flatnonzero(on_part & (parts[:, 0] == number))
                squares = edge.X[edge.pieces[which, 0], 0] ** 2
                area = np.array([0.0, np.pi * (edge.weights[which] * squares).sum()])
                self.lids[number] = Fan(np.zeros(2), area, np.zeros((2, 2)))
            return
        is_free = (abs(edge.free).max(axis=(1, 2), initial=0.0) > _ROUNDING) | (edge.parts >= 0)
        fixed = ~is_free[edge.pieces].any(axis=1)
        self._find_planes(np.flatnonzero(~on_part & ~fixed), is_free)
        # No lid is needed in a plane of symmetry.
        inside = np.array([len(self._planes_of(edge.X[p])) > 0 for p in edge.pieces], dtype=bool)
        self._check_planes(np.flatnonzero(inside))
        for number in numbers:
            which = np.flatnonzero(on_part & ~inside & (parts[:, 0] == number))
            if len(which):
                self.lids[number] = self._fan(which, edge.X)
        for which in self._connected(np.flatnonzero(fixed & ~inside)):
            try:
                self._fan(which, edge.X)
                self._fixed.append(which)
            except NotClosedError:
                if edge.moved[:, edge.pieces[which]].any():
                    raise
                self.volume_is_known = False
                self._at_rest = np.union1d(self._at_rest, edge.pieces[which])

    def _error(self, piece: int, why: str) -> NotClosedError:
        at = self._edge.X[self._edge.pieces[piece]].mean(axis=0)
        return NotClosedError(f"{why} at ({', '.join(f'{x:.6g}' for x in at)})")

    def _check_ends(self, others: Array) -> None:
        """Raise NotClosedError if the end of a curve is not on the axis and moves along it."""
        edge = self._edge
        for piece in others:
            (node,) = edge.pieces[piece]
            on_axis = abs(edge.X[node, 0]) <= _FLAT * self._length
            if not on_axis and abs(edge.free[node, 1]).max() > _ROUNDING:
                raise self._error(piece, "its edge is free")

    def _find_planes(self, pieces: Array, is_free: Array) -> None:
        """Find the planes of symmetry of some pieces; raise NotClosedError if one has none."""
        edge, several = self._edge, []
        for piece in pieces:
            nodes = edge.pieces[piece]
            own = nodes[is_free[nodes] & (edge.parts[nodes] < 0)]
            tangents = (edge.X[nodes[1:]] - edge.X[nodes[0]]) / self._length
            sizes = np.linalg.norm(tangents, axis=1).max(initial=0.0) or 1.0
            values, vectors = np.linalg.eigh(
                edge.free[own].sum(axis=0) + tangents.T @ tangents / sizes**2
            )
            normals = vectors[:, values <= _FLAT**2].T
            if not len(normals):
                raise self._error(piece, "its edge is free")
            if len(own) and len(normals) == 1:
                self._add_plane(piece, normals[0])
            else:  # along the line of two planes, or between a part and others
                several.append((piece, normals))
        for piece, normals in several:
            planes = self._planes_of(edge.X[edge.pieces[piece]])
            if not any(np.linalg.norm(normals @ plane.normal) > 1 - _FLAT for plane in planes):
                raise self._error(piece, "its edge is between two parts or supports")

    def _check_planes(self, pieces: Array) -> None:
        """Raise NotClosedError if a rigid part leaves the plane in which pieces are."""
        edge = self._edge
        for piece in pieces:
            nodes = edge.pieces[piece]
            for plane in self._planes_of(edge.X[nodes]):
                for part in np.unique(edge.parts[nodes]):
                    if part >= 0 and not self._keeps(part, plane):
                        raise self._error(piece, "a rigid part leaves the plane of symmetry")

    def _add_plane(self, piece: int, normal: Array) -> None:
        """Add the plane of a piece, if it is new."""
        edge, nodes = self._edge, self._edge.pieces[piece]
        normal = normal * np.sign(normal[abs(normal).argmax()])
        moved = edge.moved[:, nodes[edge.parts[nodes] < 0]] @ normal
        least = _ROUNDING * self._length
        if np.ptp(moved, axis=1).max(initial=0.0) > least:
            raise self._error(piece, "the plane of its edge is bent")
        offset = float((edge.X[nodes] @ normal).mean())
        plane = EdgePlane(normal, offset, bool(abs(moved).max(initial=0.0) > least))
        for other in self.planes:
            near = abs(other.offset - plane.offset) <= _FLAT * self._length
            if near and np.linalg.norm(other.normal - normal) <= _FLAT:
                if plane.moves != other.moves:
                    raise self._error(piece, "the plane of its edge is bent")
                return
        self.planes.append(plane)

    def _planes_of(
        self,
        X: Array,
        among: Sequence[EdgePlane] | None = None,
        count: Callable[[Array], bool] = all,
    ) -> list[EdgePlane]:
        """Return the planes, of all or some, that contain all, or any, of some points."""
        return [
            plane
            for plane in (self.planes if among is None else among)
            if count(abs(X @ plane.normal - plane.offset) <= _FLAT * self._length)
        ]

    def _keeps(self, part: int, plane: EdgePlane) -> bool:
        """Whether a part's motions keep its points of a plane in it."""
        normal, through = np.zeros(3), np.zeros(3)
        normal[: self._dim], through[: self._dim] = plane.normal, plane.offset * plane.normal
        if plane.moves:
            return False
        for velocity, omega in self._dirichlet.part_motions[part]:
            along = normal @ (velocity + np.cross(omega, through))
            turns = np.linalg.norm(np.cross(normal, omega)) * self._length
            size = np.linalg.norm(velocity) + np.linalg.norm(omega) * self._length
            if max(abs(along), turns) > _FLAT * size:
                return False
        return True

    def _connected(self, pieces: Array) -> list[Array]:
        """Return connected parts of some pieces; in two dimensions ends that move alike."""
        if not len(pieces):
            return []
        nodes = self._edge.pieces[pieces]
        if self._dim == 2:
            moved = self._edge.moved[:, nodes[:, 0]].swapaxes(0, 1).reshape(len(pieces), -1)
            digits = np.round(moved / (_FLAT * self._length)).astype(np.int64)
            _, labels = np.unique(digits, axis=0, return_inverse=True)
            return [pieces[labels.ravel() == i] for i in range(labels.max() + 1)]
        rows = np.repeat(np.arange(len(pieces)), nodes.shape[1])
        shape = (len(pieces), len(self._edge.X))
        touching = coo_array((np.ones(nodes.size), (rows, nodes.ravel())), shape).tocsr()
        count, labels = connected_components(touching @ touching.T, directed=False)
        return [pieces[labels == i] for i in range(count)]

    def _fan(self, which: Array, x: Array) -> Fan:
        """Return the fan that closes some pieces, where the edge's nodes are at x.

        Raises
        ------
        NotClosedError
            If they end in no plane, or in planes that leave the fan open.
        """
        edge = self._edge
        pieces, weights = edge.pieces[which], edge.weights[which]
        apex = x[np.unique(pieces)].mean(axis=0)
        net = np.zeros(len(x), dtype=int)
        np.add.at(net, pieces[:, -1], weights)
        if self._dim == 3:
            np.add.at(net, pieces[:, 0], -weights)
        ends = np.flatnonzero(net)
        if self._dim == 2 and not net.sum():  # the lid is a segment between two ends
            ends = ends[:0]
        fans = []
        if len(ends):
            open_error = self._error(which[0], "its edge ends in planes that leave it open")
            parallel = [self._has_parallel(plane) for plane in self.planes]
            undefined = not self.planes or (self._dim == 2 and any(parallel))
            if undefined or any(plane.moves for plane in self.planes):
                raise open_error
            # The apex is in all planes in which it ends and that have no parallel one.
            near = [bool(self._planes_of(edge.X[ends], [p], any)) for p in self.planes]
            around = [
                plane
                for plane, other, ends_in in zip(self.planes, parallel, near, strict=True)
                if not other and (ends_in or self._dim == 2)
            ]
            part = edge.parts[pieces[0, 0]]
            if self._dim == 2 and part >= 0 and not all(self._keeps(part, p) for p in around):
                raise self._error(which[0], "a rigid part leaves the plane of symmetry")
            apex = self._project(apex, around)
            if self._planes_of(apex[None], around) != around:
                raise open_error
            sums: dict[EdgePlane, int] = {}
            for node in ends if self._dim == 3 else ():
                planes = self._planes_of(edge.X[node : node + 1])
                if any(plane in around for plane in planes):
                    continue
                if not planes:
                    raise open_error
                sums[planes[0]] = sums.get(planes[0], 0) + int(net[node])
                line = np.stack([x[node], self._project(apex, [*around, planes[0]])])
                fans.append(_sweep(line[None], net[node : node + 1], apex))
            if any(sums.values()) and not around:
                raise open_error
        fans.append(_sweep(x[pieces], weights, apex))
        area, moment = (sum(values) for values in zip(*fans, strict=True))
        return Fan(apex, area, moment)

    def _has_parallel(self, plane: EdgePlane) -> bool:
        same = [abs(other.normal - plane.normal).max() <= _FLAT for other in self.planes]
        return same.count(True) > 1

    def _project(self, point: Array, planes: Sequence[EdgePlane]) -> Array:
        """Return the nearest point in planes, or near them if they do not meet."""
        if not planes:
            return point
        normals = np.array([plane.normal for plane in planes])
        distances: Array = np.array([plane.offset for plane in planes]) - normals @ point
        return point + np.linalg.lstsq(normals, distances, rcond=_FLAT)[0]

    def facets_of_part(self, part: int, others: Array) -> Array:
        """Return this rank's facets of the boundary on a part that are not among others."""
        V = self._V
        facets, cells, local = _dolfinx.exterior_facets(V.mesh)
        nodes = _dolfinx.node_dofs(V)[cells[:, None], _dolfinx.facet_nodes(V)[local]]
        return facets[(self.parts[nodes] == part).all(axis=1) & ~np.isin(facets, others)]

    def field(self, centre: Array) -> tuple[Array, Array]:
        """Return A and b [m] of a field f(x) = A (x - centre) + b that crosses no plane.

        Raises
        ------
        NotClosedError
            If there is none: the planes are those of a closed prism, or one of a cone's moves.
        """
        dim = self._dim
        rows, values = [np.append(np.eye(dim).ravel(), np.zeros(dim))], [1.0]
        for plane in self.planes:
            n = plane.normal
            directions = np.eye(dim) if plane.moves else np.linalg.svd(n[None])[2][1:]
            rows += [np.append(np.outer(n, t).ravel(), np.zeros(dim)) for t in directions]
            inside = (plane.offset - centre @ n) * n / self._length
            rows.append(np.append(np.outer(n, inside).ravel(), n))
            values += [0.0] * (len(directions) + 1)
        # The smallest change of the field (x - centre)/dim.
        usual = np.append(np.eye(dim).ravel() / dim, np.zeros(dim))
        table = np.array(rows)
        change = np.linalg.lstsq(table, np.array(values) - table @ usual, rcond=_FLAT)[0]
        found = usual + change
        if abs(table @ found - values).max() > _ROUNDING:
            raise NotClosedError("no field of divergence 1 crosses none of its planes of symmetry")
        return found[: dim**2].reshape(dim, dim), self._length * found[dim**2 :]

    def flux(self, A: Array, b: Array, centre: Array, u: PETSc.Vec | None = None) -> float:
        """Return the flux of a field through the fans of prescribed nodes [m^3]. Collective.

        At displacements ``u``, or at rest.
        """
        x, total = self._edge.X, 0.0
        if u is not None and (self._fixed or len(self._at_rest)):
            moved = _gather(self._V, u.array_r, self._edge.numbers)[:, : self._dim]
            x = x + moved
            self._check_motion(moved)
        for which in self._fixed:
            fan = self._fan(which, x)
            total += float((A @ (fan.apex - centre) + b) @ fan.area + (A * fan.moment).sum())
        return total

    def _check_motion(self, moved: Array) -> None:
        """Raise BadInput if values that a program changes leave the surface open."""
        least, sizes = _FLAT * self._length, [abs(moved[self._at_rest]).max(initial=0.0)]
        if self._dim == 2:
            ends = [moved[self._edge.pieces[which, 0]] for which in self._fixed]
            sizes += [np.ptp(displacements, axis=0).max() for displacements in ends]
        if max(sizes) > least:
            raise BadInput("the constrained edge of a surface moves and leaves it open")


def _sweep(pieces: Array, weights: Array, apex: Array) -> tuple[Array, Array]:
    """Return area and moment of the fan between an apex and pieces (n, nodes, dim) of an edge."""
    arms = pieces - apex
    if arms.shape[2] == 2 and arms.shape[1] == 1:
        arms = arms[:, 0]
        normals = -weights[:, None] * np.stack([arms[:, 1], -arms[:, 0]], axis=1)
        return normals.sum(axis=0), normals.T @ arms / 2
    degree = arms.shape[1] - 1
    points, factors = np.polynomial.legendre.leggauss((3 * degree + 1) // 2)
    table = _dolfinx.tabulate_element("interval", degree, (points[:, None] + 1) / 2, 1)
    # Ends come first in the element's order, last in that of pieces.
    order = [0, degree, *range(1, degree)]
    at, along = np.einsum("dqk,nkc->dnqc", table, arms[:, order])
    normals = -np.cross(at, along) * (weights[:, None] * factors / 2)[:, :, None]
    return normals.sum(axis=(0, 1)) / 2, np.einsum("nqi,nqj->ij", normals, at) / 3


def edge_of(V: _dolfinx.FunctionSpace, facets: Array, dirichlet: Dirichlet, dim: int) -> Edge:
    """Return the edge of a surface, of which ``facets`` are this rank's. Collective."""
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
        u.set(0.0)
        dirichlet.set_values(u, load)
        columns.append(u.array_r.reshape(owned, components)[:, :dim])
    table = _gather(V, np.hstack(columns), numbers)
    X, free, parts, moved = np.split(table, np.cumsum([dim, dim**2, 1]), axis=1)
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
    """Return rows of values of the owned nodes, or of their dofs, by global numbers. Collective."""
    if values.ndim == 1:
        values = values.reshape(-1, _dolfinx.num_components(V))
    local = numbers - _dolfinx.local_to_global(V)[0] if len(values) else numbers * 0 - 1
    mine = (local >= 0) & (local < len(values))
    found = np.zeros((len(numbers), values.shape[1]))
    found[mine] = values[local[mine]]
    return np.asarray(V.mesh.comm.allreduce(found))


def _pieces_of_facets(V: _dolfinx.FunctionSpace, facets: Array) -> tuple[Array, Array]:
    """Return the edges, or ends, of this rank's facets: local nodes and weights, as in `Edge`."""
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
    """Return the pieces whose weights have a sum that is not zero, from the lower number on."""
    every, weight = np.concatenate(pieces), np.concatenate(weights)
    if every.shape[1] > 1:
        backward = every[:, 0] > every[:, -1]
        every[backward] = every[backward, ::-1]
        weight = np.where(backward, -weight, weight)
    every, which = np.unique(every, axis=0, return_inverse=True)
    sums = np.bincount(which.ravel(), weight, minlength=len(every)).round().astype(int)
    return every[sums != 0], sums[sums != 0]
