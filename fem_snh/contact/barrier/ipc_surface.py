"""A surface of triangles for ipctk: distances, intersections, steps without a collision.

Only this file and `fem_snh.contact.barrier.ipc_friction` import ipctk, whose API changes between
minor versions. Its vertices are rows of arrays in Fortran order, its distances are squared.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.sparse import csgraph, csr_matrix

from fem_snh.errors import BadInput

Array = npt.NDArray[Any]

#: Default activation distance in the mean length of the surface's edges.
_DISTANCE = 0.1
#: It is reduced to this fraction of the smallest distance in the mesh, where nothing should touch.
_OF_SMALLEST = 0.9
#: Smallest distance in the mesh, in edges, of two parts that do not touch.
_TOUCHING = 1e-4
#: Iterations for one pair, after which the length reached so far is taken, which is free of
#: collisions. By default there are ten million: parts that slide along each other by far more than
#: their distance take as many as the ratio of both.
_CCD_ITERATIONS = 1000
#: Longest step [m] that ipctk gets: it squares distances, and does not return where they overflow.
_LARGEST = 1e140
#: Candidates are searched this many activation distances farther than collisions reach; they are
#: valid until a point has moved by half of it.
_MARGIN = 1.0


def import_ipctk() -> Any:
    """Return the module ipctk, which works on one thread; raise BadInput if it is missing."""
    try:
        import ipctk
    except ImportError:
        raise BadInput(
            "self_contact.method = 'ipc' needs the package ipctk: pip install 'fem_snh[contact]'"
        ) from None
    # One thread adds in one order: all ranks get the same bits, and MPI uses the other cores.
    ipctk.set_num_threads(1)
    return ipctk


class CollisionSurface:
    """A closed surface, of one or several bodies, that must not intersect itself. Not collective.

    Points, edges and triangles that share a point never collide.

    Parameters
    ----------
    points : (n, 3)
        Reference positions [m].
    triangles : (m, 3) int32
        Points of each triangle.

    Attributes
    ----------
    ipctk : module
        The package.
    mesh : ipctk.CollisionMesh
        The surface.
    edge_length : float
        Mean length of the edges [m].
    bodies : (n,) int
        The connected part of the surface to which each point belongs, from 0 on.

    Raises
    ------
    BadInput
        If ipctk is missing.
    """

    def __init__(self, points: Array, triangles: Array) -> None:
        self.ipctk = import_ipctk()
        self._edges = self.ipctk.edges(triangles)
        self.mesh = self.ipctk.CollisionMesh(_rows(points), self._edges, triangles)
        a, b = self._edges.T
        self.edge_length = float(np.linalg.norm(points[a] - points[b], axis=1).mean())
        graph = csr_matrix((np.ones(len(a)), (a, b)), shape=(len(points),) * 2)
        self.bodies = csgraph.connected_components(graph, directed=False)[1]
        # Additive CCD (Li et al. 2021, section 4) is conservative. ipctk's default, an interval
        # search, takes up to 100 times as long where faces approach each other in parallel.
        self._ccd = self.ipctk.AdditiveCCD(_CCD_ITERATIONS)
        self._candidates: tuple[Array, float, Any] | None = None
        self._triangles = triangles

    def forget(self) -> None:
        """Search candidates again, so that a resumed run adds in the order of the whole one."""
        self._candidates = None

    def collisions(self, x: Array, distance: float) -> Any:
        """Return the ipctk.NormalCollisions of points x (n, 3) that are closer than a distance [m].

        Areas are their weights (Li et al. 2023), so that a pressure depends on the distance and
        little on the mesh. ipctk's improved max approximation would remove that dependence, but its
        energy jumps by 0.1 % where the closest parts change, at which a line search stops.
        """
        found = self.ipctk.NormalCollisions()
        found.use_area_weighting = True
        x = _rows(x)
        found.build(self._near(x, distance), self.mesh, x, distance)
        return found

    def smallest_distance(self, x: Array, reach: float) -> float:
        """Return the smallest distance [m] of parts that share no point; inf beyond a reach."""
        found = self.collisions(x, reach).compute_minimum_distance(self.mesh, _rows(x))
        return float(np.sqrt(found))

    def sums(self, forces: Array) -> list[list[float]]:
        """Return the sum of the points' forces (n, 3) for each body, (bodies, 3) [N]."""
        count = self.bodies.max() + 1
        sums = np.transpose([np.bincount(self.bodies, f, count) for f in forces.T])
        return [[float(f) for f in row] for row in sums]

    def default_distance(self, points: Array) -> float:
        """Return the default activation distance [m] for reference points (n, 3)."""
        wanted = _DISTANCE * self.edge_length
        return min(wanted, _OF_SMALLEST * self.smallest_distance(points, wanted / _OF_SMALLEST))

    def check(self, x: Array, where: str) -> None:
        """Raise BadInput if the surface at points x intersects or touches itself.

        ``where`` completes the message: "in the mesh", "at the start".
        """
        accepted = "expected a surface that neither intersects nor touches itself"
        at = self.intersection(x)
        if at is not None:
            place = ", ".join(f"{value:.4g}" for value in at)
            raise BadInput(
                f"self_contact.method = 'ipc': {accepted} {where}; it does near ({place})"
            )
        least = _TOUCHING * self.edge_length
        distance = self.smallest_distance(x, least)
        if distance < least:
            raise BadInput(
                f"self_contact.method = 'ipc': {accepted} {where}; the smallest distance of parts "
                f"without a common node is {distance:.3g}, less than {least:.3g}"
            )

    def intersects(self, x: Array) -> bool:
        """Return whether the surface at points x (n, 3) intersects itself."""
        return bool(self.ipctk.has_intersections(self.mesh, _rows(x)))

    def intersection(self, x: Array) -> Array | None:
        """Return the middle of an edge that intersects a triangle, (3,) [m]; None if none does."""
        if not self.intersects(x):
            return None
        search = self.ipctk.LBVH()
        search.build(_rows(x), self._edges, self._triangles, 0.0)
        for found in search.detect_edge_face_candidates():
            edge, triangle = self._edges[found.edge_id], self._triangles[found.face_id]
            if np.isin(edge, triangle).any():
                continue
            if self.ipctk.is_edge_intersecting_triangle(*x[edge], *x[triangle]):
                return np.asarray(x[edge].mean(axis=0))
        return np.asarray(x.mean(axis=0))

    def largest_step(self, x: Array, d: Array) -> float:
        """Return a length in [0, 1] up to which x + s d (n, 3) meets no collision.

        It is 1 if there is none, else about 0.9 of the length at the first one; 0 if d is not
        finite, with which ipctk does not return.
        """
        largest = np.abs(d).max(initial=0.0)
        if not np.isfinite(largest):
            return 0.0
        part = min(1.0, _LARGEST / max(float(largest), 1.0))
        start, end = _rows(x), _rows(x + part * d)
        step = self.ipctk.compute_collision_free_stepsize(
            self.mesh, start, end, narrow_phase_ccd=self._ccd
        )
        return part * float(step)

    def _near(self, x: Array, distance: float) -> Any:
        """Return the candidates of collisions within a distance, of a recent search if possible."""
        if self._candidates is not None:
            before, reach, found = self._candidates
            moved = float(np.linalg.norm(x - before, axis=1).max(initial=0.0))
            if distance + 2 * moved <= reach:
                return found
        reach = (1 + _MARGIN) * distance
        found = self.ipctk.Candidates()
        found.build(self.mesh, x, reach / 2)  # the boxes of both parts are enlarged
        self._candidates = np.array(x), reach, found
        return found


def _rows(x: Array) -> Array:
    """Return points as ipctk expects them."""
    return np.asfortranarray(x, dtype=float)
