"""Surfaces of a distributed body that every rank has as a whole: nodes, facets, positions.

Contact between two surfaces couples nodes of any two ranks. A surface has few nodes beside those of
the body, so every rank gathers all of them, evaluates the same contact and keeps its own rows.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.contact.surface_quadrature import SurfaceQuadrature, cross_tangents

Array = npt.NDArray[Any]


class GatheredNodes:
    """Nodes of a displacement space, in the same order on all ranks. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    nodes : (n,) int64
        Global nodes of V, of any rank, in any order; all ranks together give the nodes.

    Attributes
    ----------
    nodes : (m,) int64
        The global nodes, sorted, each once.
    is_own : (m,) bool
        Whether this rank owns the node.
    X : (m, 3)
        Their reference coordinates [m].
    """

    def __init__(self, V: Any, nodes: Array) -> None:
        self._V, self.comm = V, V.mesh.comm  # the mesh frees its communicator
        numbers, owned = _dolfinx.local_to_global(V), _dolfinx.num_nodes(V)[0]
        self.nodes = np.unique(np.concatenate(self.comm.allgather(np.unique(nodes))))
        # Global numbers of a rank's own nodes are contiguous.
        first = int(numbers[0]) if owned else 0
        self.is_own = (self.nodes >= first) & (self.nodes < first + owned)
        self._own = self.nodes[self.is_own] - first
        self.X = self.gather(V.tabulate_dof_coordinates()[:owned])

    def gather(self, values: Array) -> Array:
        """Return nodal values (local nodes, 3) of all the nodes, (m, 3). Collective."""
        # The nodes are sorted and each rank's own ones contiguous: the ranks follow each other.
        return np.concatenate(self.comm.allgather(np.array(values[self._own])))

    def add_own(self, values: Array, out: Array) -> None:
        """Add those of the nodes' values (m, 3) that this rank owns to ``out`` (local nodes, 3)."""
        out[self._own] += values[self.is_own, : out.shape[1]]


#: Reference coordinates are rounded to this fraction of the surface's size before they are sorted,
#: so that the order of facets is the same on any number of ranks.
_ROUNDING = 1e-9
#: Distance on the reference facet below which two points are the same; nodes are 1/2 apart.
_SAME = 1e-6


class FacetShape:
    """The shape functions of a facet, with the nodes in the order of `SurfaceQuadrature`.

    Parameters
    ----------
    kind : {"triangle", "quadrilateral", "interval"}
        The reference facet.
    degree : int
        Degree of the displacement.

    Attributes
    ----------
    kind : str
        The reference facet.
    nodes : (k, d)
        Reference coordinates of the nodes.
    center : (d,)
        Mean of the corners.
    rim : (n, d) int
        The edges between neighbouring nodes around the facet, anticlockwise; of a curve the nodes
        on both sides of its middle, each with the sense in ``sense``.
    sense : (n,)
        1 or -1: whether the simplex of the centre and a part of the rim has the facet's sense.
    """

    def __init__(self, kind: str, degree: int) -> None:
        self.kind, self._degree = kind, degree
        nodes = _dolfinx.reference_nodes(kind, degree)
        self._order = np.lexsort(np.round(nodes / _SAME).T)
        self.nodes = nodes[self._order]
        self.center = _dolfinx.reference_corners(kind).mean(axis=0)
        arms = self.nodes - self.center
        if kind == "interval":
            self.rim = np.argsort(arms[:, 0])[[0, -1], None]
            self.sense = np.array([-1.0, 1.0])
            return
        turn = np.argsort(np.arctan2(arms[:, 1], arms[:, 0]))
        outline = turn[np.linalg.norm(arms, axis=1)[turn] > _SAME]
        self.rim = np.stack([outline, np.roll(outline, -1)], axis=1)
        self.sense = np.ones(len(outline))

    def evaluate(self, points: Array, order: int = 1) -> tuple[Array, ...]:
        """Return values, first and second derivatives up to an order at reference points (n, d).

        Their shapes are (n, k), (n, k, d) and (n, k, d, d).
        """
        table = _dolfinx.tabulate_element(self.kind, self._degree, points, order)
        table = np.moveaxis(table[..., self._order], 0, -1)
        d = self.nodes.shape[1]
        # basix's second derivatives are xx, xy, yy; of a curve xx.
        second = [[3, 4], [4, 5]] if d == 2 else [[2]]
        parts = (
            table[..., 0],
            table[..., 1 : 1 + d],
            table[..., second] if order > 1 else None,
        )
        return tuple(part for part in parts[: order + 1] if part is not None)

    def outside(self, points: Array) -> Array:
        """Return how far reference points (n, d) are outside of the facet; <= 0 inside."""
        sums = points.sum(axis=1) if self.kind == "triangle" else points.max(axis=1)
        return np.maximum(-points.min(axis=1), sums - 1)


@dataclass(frozen=True)
class Side:
    """The facets of one surface, in an order that does not depend on the ranks.

    Attributes
    ----------
    nodes : (facets, k) int
        Rows of ``GatheredSurface.X``.
    outward : (facets,)
        1 where the derivatives of the facet's map form the outward normal, -1 where its opposite.
    weights : (facets, points)
        Quadrature weights in the reference configuration [m^2].
    basis : (points, k)
        Shape functions at the quadrature points.
    derivatives : (points, k, d)
        Their derivatives there.
    areas : (facets,)
        Areas of the facets at rest [m^2], of curves their lengths [m].
    own : (n,) int
        The facets whose cells this rank owns.
    """

    nodes: Array
    outward: Array
    weights: Array
    basis: Array
    derivatives: Array
    areas: Array
    own: Array

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def mean_size(self) -> float:
        """The size of facets: the root of their mean area, of curves the mean length [m]."""
        return float(self.areas.mean() ** (1 / self.derivatives.shape[2]))

    @property
    def sizes(self) -> Array:
        """The sizes of the facets: the roots of their areas, of curves the lengths [m]."""
        return np.asarray(self.areas ** (1 / self.derivatives.shape[2]))


class GatheredSurface:
    """The nodes of some surfaces, on every rank. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    surfaces : sequence of SurfaceQuadrature
        Each rank's facets of each surface.

    Attributes
    ----------
    shape : FacetShape
        The shape functions of a facet.
    nodes : (m,) int64
        Global nodes of V, sorted.
    X : (m, 3)
        Their reference coordinates [m].
    is_own : (m,) bool
        Whether this rank owns the node.
    sides : list of Side
        The facets of each surface.
    components : int
        Components of the displacement.
    """

    def __init__(self, V: Any, surfaces: Sequence[SurfaceQuadrature]) -> None:
        domain, self.comm, self.components = V.mesh, V.mesh.comm, _dolfinx.num_components(V)
        kind = _dolfinx.FACET_OF[_dolfinx.cell_name(domain)]
        self.shape = FacetShape(kind, _dolfinx.degree(V))
        numbers = _dolfinx.local_to_global(V)
        wanted = [numbers[surface.nodes.ravel()] for surface in surfaces]
        self._gathered = GatheredNodes(V, np.concatenate(wanted))
        self.nodes, self.is_own = self._gathered.nodes, self._gathered.is_own
        self.X = self._gathered.X
        X = V.tabulate_dof_coordinates()[: len(numbers)]
        self.sides = [self._side(X, numbers, surface) for surface in surfaces]

    def positions(self, u: Array) -> Array:
        """Return the deformed coordinates of the nodes [m], (m, 3). Collective.

        ``u`` are this rank's nodal displacements (local nodes, 3).
        """
        return self.X + self._gathered.gather(u)

    def add_own(self, values: Array, out: Array) -> None:
        """Add those of the nodes' values (m, 3) that this rank owns to ``out`` (local nodes, 3)."""
        self._gathered.add_own(values, out)

    def _side(self, X: Array, numbers: Array, surface: SurfaceQuadrature) -> Side:
        local = X[surface.nodes]
        tangents = np.einsum("fki,pkj->fpij", local, surface.derivatives, optimize=True)
        cross = cross_tangents(tangents)
        sign = np.sign(np.einsum("fpi,fpi->f", cross, surface.normals))
        mine = (numbers[surface.nodes], sign, surface.weights, surface.areas, local.mean(axis=1))
        gathered = self.comm.allgather(mine)
        nodes, outward, weights, areas, middles = map(np.concatenate, zip(*gathered, strict=True))
        size = float(np.abs(self.X - self.X.mean(axis=0)).max())
        order = np.lexsort(np.round(middles / (_ROUNDING * size)).T)
        before = sum(len(found[0]) for found in gathered[: self.comm.rank])
        own = np.flatnonzero((order >= before) & (order < before + len(surface.nodes)))
        return Side(
            np.searchsorted(self.nodes, nodes[order]),
            outward[order],
            weights[order],
            surface.basis,
            surface.derivatives,
            areas[order],
            own,
        )
