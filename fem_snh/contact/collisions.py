"""The barrier of a surface's collisions, and their friction: no MPI, no finite elements.

Only this module imports ipctk, whose API changes between minor versions. Its vertices are rows of
arrays in Fortran order, its distances are squared.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import bsr_matrix, csgraph, csr_matrix

from fem_snh.errors import BadInput
from fem_snh.processes import call
from fem_snh.terms.settling import relative

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
    """Return the module ipctk, which works on one thread.

    Raises
    ------
    BadInput
        If it is missing, or crashes: some of its wheels need instructions that not every processor
        has.
    """
    try:
        import ipctk
    except ImportError:
        raise BadInput(
            "self_contact.method = 'ipc' needs the package ipctk: pip install 'fem_snh[contact]'"
        ) from None
    if crash := _crash():
        raise BadInput(
            f"self_contact.method = 'ipc': {crash} on one triangle: expected a processor for which "
            "the package is compiled, or method = 'reference'"
        )
    # One thread adds in one order: all ranks get the same bits, and MPI uses the other cores.
    ipctk.set_num_threads(1)
    return ipctk


@cache
def _crash() -> str:
    """Return how ipctk crashes on this processor; empty if it works."""
    try:
        call("ipctk", enclose_one_triangle)
    except BadInput as error:
        return str(error).partition(":")[0]
    return ""


def enclose_one_triangle() -> int:
    """Return the number of points of ipctk's mesh of one triangle."""
    import ipctk

    triangle = np.asfortranarray([[0, 1, 2]], dtype=np.int32)
    return int(ipctk.CollisionMesh(_rows(np.eye(3)), ipctk.edges(triangle), triangle).num_vertices)


class CollisionSurface:
    """A closed surface, of one or several bodies, that must not intersect itself. Not collective.

    Points, edges and triangles that share a point never collide.

    Parameters
    ----------
    points : (n, 3)
        Reference positions [m].
    triangles : (m, 3) int32
        Points of each triangle; (m, 2) of each segment, in two dimensions. Points that methods get
        are then (n, 2).
    areas : (n,), optional
        The areas of the points [m^2]; default: those of the triangles, or of the segments per
        thickness.

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

    def __init__(self, points: Array, triangles: Array, areas: Array | None = None) -> None:
        self.ipctk = import_ipctk()
        if triangles.shape[1] == 2:
            self._edges, points = triangles, points[:, :2]
            self.mesh = self.ipctk.CollisionMesh(_rows(points), triangles)
        else:
            self._edges = self.ipctk.edges(triangles)
            self.mesh = self.ipctk.CollisionMesh(_rows(points), self._edges, triangles)
        if areas is not None:
            self.mesh.vertex_areas = areas
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
        energy jumps where the closest parts change, at which a line search stops.
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
        """Return the sum of the points' forces for each body, three components [N]."""
        forces = np.pad(forces, ((0, 0), (0, 3 - forces.shape[1])))
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
        if self._triangles.shape[1] == 2:
            return np.asarray(x.mean(axis=0))
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


#: Slip of a step below which surfaces stick, in activation distances: far below what is seen, and
#: large enough that Newton's method meets no kink.
_STICKING = 0.05


class SurfaceFriction:
    r"""The energy of friction in a step, of the slip since its start. Not collective.

    With the lagged normal force :math:`\ell_k` and tangent plane of a collision, on which
    :math:`T_k` projects,

    .. math:: E = \sum_k \mu \ell_k f_0(|s_k|), \qquad
        f_0'(y) = \begin{cases} 2 y/\epsilon - y^2/\epsilon^2 & y < \epsilon \\ 1 \end{cases}

    (Li et al. 2020, eq. 13 to 16). The slip is :math:`s_k = T_k (r_k - c_k r_k^0)`, with the
    vector r between the closest points of both parts and the same vector at the start of the step,
    which :math:`c_k \le 1` shortens to the lagged distance along the lagged normal: an approach is
    no slip. With :math:`c_k = 1` it is one as soon as the normal tilts; where the parts stick, the
    next solve tilts the normal back by the ratio of both distances, and the step does not settle.

    Parameters
    ----------
    surface : CollisionSurface
        The surface.
    coefficient : float
        Coulomb's coefficient mu.
    distance : float
        The barrier's activation distance [m].
    """

    def __init__(self, surface: CollisionSurface, coefficient: float, distance: float) -> None:
        self._surface, self._mu, self._distance = surface, coefficient, distance
        self._start: Array = np.zeros(0)
        self._lagged: _LaggedSlip | None = None

    @property
    def acts(self) -> bool:
        """Whether there is a collision with friction."""
        return self._lagged is not None

    def begin_step(self, x: Array) -> None:
        """Start a step at points x (n, 3) [m], without forces until `lag`."""
        self._start, self._lagged = np.array(x), None

    def lag(self, x: Array, collisions: Any, barrier: Any) -> None:
        """Set normal forces, tangents and the origin of slip to those of collisions at x."""
        self._lagged = self._slip(x, collisions, barrier)

    def change(self, x: Array, collisions: Any, barrier: Any) -> float:
        """Return the norm of how `lag` would change the forces at x [N]."""
        after = self._gradient(self._slip(x, collisions, barrier), x)
        return float(np.linalg.norm(after - self.gradient(x)))

    def energy(self, x: Array) -> float:
        """Return the energy [J] at points x (n, 3)."""
        if self._lagged is None:
            return 0.0
        y, width = np.linalg.norm(self._lagged.slip(x), axis=1), self._width
        sticking = y**2 / width - y**3 / (3 * width**2) + width / 3
        return float(self._lagged.limit @ np.where(y < width, sticking, y))

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative [N] by the points, (n, 3)."""
        return self._gradient(self._lagged, x)

    def hessian(self, x: Array) -> Any:
        """Return the second derivative [N/m], a sparse (3 n, 3 n) matrix without negative values.

        The energy is convex.
        """
        assert self._lagged is not None
        slip, matrix = self._lagged.slip(x), self._lagged.matrix
        y, limit = np.linalg.norm(slip, axis=1), self._lagged.limit
        unit = slip / np.where(y > 0, y, 1.0)[:, None]
        # f_0'' - f_0'/y
        along = np.where(y < self._width, -y / self._width**2, -1 / np.maximum(y, self._width))
        blocks = self._factor(y)[:, None, None] * np.eye(slip.shape[1])
        blocks += along[:, None, None] * unit[:, :, None] * unit[:, None, :]
        count = len(y)
        middle = bsr_matrix((limit[:, None, None] * blocks, np.arange(count), np.arange(count + 1)))
        return (matrix.T @ middle @ matrix).tocsc()

    @property
    def _width(self) -> float:
        return _STICKING * self._distance

    def _factor(self, y: Array) -> Array:
        """Return f_0'(y) / y."""
        width = self._width
        return np.where(y < width, 2 / width - y / width**2, 1 / np.maximum(y, width))

    def _slip(self, x: Array, collisions: Any, barrier: Any) -> _LaggedSlip | None:
        """Return what `lag` keeps of collisions at points x; None without friction.

        ipctk's own tangential collisions leave out edges that are nearly parallel, whose forces
        then jump where the closest parts change.
        """
        count, dim = len(collisions), x.shape[1]
        if not self._mu > 0 or not count:
            return None
        x, mesh = _rows(x), self._surface.mesh
        edges, faces = mesh.edges, mesh.faces
        points, weights = np.zeros((count, 4), dtype=int), np.zeros((count, 4))
        limit = np.empty(count)
        for k in range(count):
            one = collisions[k]
            vertices = one.dof(x, edges, faces)
            size = len(vertices) // dim
            points[k, :size] = one.vertex_ids(edges, faces)[:size]
            weights[k, :size] = one.compute_coefficients(vertices)
            force = barrier.force_magnitude(one.compute_distance(vertices), one.dmin)
            smooth = one.mollifier(vertices) if one.is_mollified() else 1.0
            limit[k] = self._mu * one.weight * smooth * force
        start, end = (np.einsum("ki,kid->kd", weights, at[points]) for at in (self._start, x))
        distance = np.linalg.norm(end, axis=1)
        normal = end / distance[:, None]
        shorter = distance / np.maximum((start * normal).sum(axis=1), distance)
        tangential = np.eye(dim) - normal[:, :, None] * normal[:, None, :]
        offset = shorter[:, None] * np.einsum("kde,ke->kd", tangential, start)
        values = np.einsum("kde,ki->kdie", tangential, weights)
        columns = dim * points[:, None, :, None] + np.arange(dim)
        rows = np.arange(count * dim).reshape(count, dim, 1, 1)
        rows, columns = (np.broadcast_to(index, values.shape).ravel() for index in (rows, columns))
        matrix = csr_matrix((values.ravel(), (rows, columns)), shape=(count * dim, x.size))
        return _LaggedSlip(matrix, offset, limit)

    def _gradient(self, lagged: _LaggedSlip | None, x: Array) -> Array:
        if lagged is None:
            return np.zeros(x.shape)
        slip = lagged.slip(x)
        forces = (lagged.limit * self._factor(np.linalg.norm(slip, axis=1)))[:, None] * slip
        return np.asarray(lagged.matrix.T @ forces.ravel()).reshape(x.shape)


class _LaggedSlip(NamedTuple):
    """The slip of k collisions, for lagged normals.

    Attributes
    ----------
    matrix : (k d, n d) sparse
        From the coordinates of points to relative positions in the tangent planes.
    offset : (k, d)
        Relative positions from which the slip counts [m].
    limit : (k,)
        Coulomb's limit of the force, mu times the lagged normal force [N].
    """

    matrix: Any
    offset: Array
    limit: Array

    def slip(self, x: Array) -> Array:
        """Return the slip at points x (n, d), (k, d) [m]."""
        return np.asarray((self.matrix @ x.ravel()).reshape(self.offset.shape) - self.offset)


#: The sparsity pattern has all pairs within this many activation distances.
_PATTERN = 2.0
#: Friction has settled when new normal forces change its forces by less than this fraction of them.
_SETTLED = 1e-3


class BarrierEnergy:
    r"""The energy of a barrier between all parts of a surface, and of friction. Not collective.

    .. math:: E = \kappa \hat d \sum_k w_k\, b(d_k/\hat d), \qquad
        b(s) = -(s^2 - 1)^2 \ln s^2 \quad \text{for}\ s < 1

    over pairs of points, edges and triangles of distance d_k and area w_k (Li et al. 2020, eq. 6;
    Li et al. 2023 for the areas). Points ``x`` are (n, 3) [m].

    Parameters
    ----------
    surface : CollisionSurface
        The surface.
    stiffness : float
        The stiffness kappa [Pa].
    distance : float
        The activation distance [m].
    friction : float
        Coulomb's coefficient.

    Attributes
    ----------
    friction : SurfaceFriction
        The energy of friction.
    """

    def __init__(
        self, surface: CollisionSurface, stiffness: float, distance: float, friction: float
    ) -> None:
        self._surface, self._distance, self._coefficient = surface, distance, friction
        ipctk = surface.ipctk
        self._barrier = ipctk.BarrierPotential(distance, stiffness, True)
        projections = ipctk.PSDProjectionMethod
        self._projections = {
            "exact": projections.NONE,
            "clamp": projections.CLAMP,
            "abs": projections.ABS,
        }
        self.friction = SurfaceFriction(surface, friction, distance)
        self._last: tuple[Array, Any] | None = None

    def collisions(self, x: Array) -> Any:
        """Return the ipctk.NormalCollisions at points x, of the last call if x is the same."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x, self._surface.collisions(x, self._distance)
        return self._last[1]

    def energy(self, x: Array) -> float:
        """Return the energy of the barrier, without friction [J]."""
        return float(self._barrier(self.collisions(x), self._surface.mesh, x))

    def gradient(self, x: Array) -> Array:
        """Return the derivative of the energy and of that of friction, (n, 3) [N]."""
        found = self._barrier.gradient(self.collisions(x), self._surface.mesh, x)
        return np.asarray(found).reshape(x.shape) + self.friction.gradient(x)

    def hessian(self, x: Array, filter: str) -> Any:
        """Return the filtered second derivative [N/m], a sparse (3 n, 3 n) matrix."""
        projection = self._projections[filter]
        found = self._barrier.hessian(self.collisions(x), self._surface.mesh, x, projection)
        return found + self.friction.hessian(x) if self.friction.acts else found

    def pattern(self, x: Array) -> Any:
        """Return a sparse matrix of ones, where the Hessian of a wider barrier has entries."""
        wide = _PATTERN * self._distance
        barrier = self._surface.ipctk.BarrierPotential(wide, 1.0, True)
        found = barrier.hessian(self._surface.collisions(x, wide), self._surface.mesh, x)
        found.data[:] = 1.0
        return found

    def begin_step(self, x: Array) -> None:
        """Start the slip of a step at points x; `lag` gives it forces."""
        self._surface.forget()
        self._last = None
        self.friction.begin_step(x)

    def lag(self, x: Array) -> None:
        """Set the normal forces of friction to those at points x."""
        self.friction.lag(x, self.collisions(x), self._barrier)

    def settle(self, x: Array) -> float:
        """Update the normal forces of friction; return the change of its forces, in its tolerance.

        They are kept where the change is below the tolerance.
        """
        change = self.friction.change(x, self.collisions(x), self._barrier)
        normal = self.gradient(x) - self.friction.gradient(x)
        ratio = relative(change, self._coefficient * float(np.linalg.norm(normal)), _SETTLED)
        if not ratio <= 1:
            self.lag(x)
        return ratio
