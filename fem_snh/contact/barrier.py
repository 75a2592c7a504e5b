"""Self-contact by a barrier: surfaces that never intersect (incremental potential contact).

Only this module imports ipctk, whose API changes between minor versions. Its vertices are rows of
arrays in Fortran order, its distances are squared.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, NamedTuple, Self

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import bsr_matrix, csgraph, csr_matrix

from fem_snh._dolfinx import FunctionSpace
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region, reference_modulus
from fem_snh.choices import FILTERS
from fem_snh.contact.gathered_surface import Blocks, point_areas
from fem_snh.contact.surface_contact import SelfContactTerm
from fem_snh.errors import BadInput, NotSettled, choose
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.processes import call
from fem_snh.terms.term import LaggedChange, StepLimitingTerm, WorkingTerm, relative

Array = npt.NDArray[Any]

#: Default stiffness in the materials' modulus: a contact pressure of E leaves about half of the
#: activation distance.
_STIFFNESS = 0.1


class IPC(SelfContactTerm, WorkingTerm, StepLimitingTerm):
    """Self-contact by a barrier, with friction: the term of `BarrierEnergy`. Collective.

    The energy is infinite where surfaces touch. `largest_step` keeps every step shorter than its
    first collision, so that the surface never intersects itself. Every rank evaluates the whole
    surface and keeps its own rows.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    skin : Skin or None
        The surface, if a lattice carries it; None for the boundary of the mesh.
    regions : sequence of Region
        The materials, which the default stiffness depends on.
    stiffness : float, optional
        The barrier's stiffness kappa [Pa]. Default: a tenth of the materials' modulus.
    distance : float, optional
        The distance d at which contact begins [m]. Default: a tenth of the mean edge, at most 0.9
        of the smallest distance in the mesh.
    friction : float, optional
        Coulomb's coefficient mu.
    kinematics : Kinematics, optional
        That of the displacement: of a solid, of a plane, or axisymmetric.

    Attributes
    ----------
    collision_surface : CollisionSurface
        Its geometry.
    stiffness, distance : float
        See the parameters.

    Raises
    ------
    BadInput
        On every rank, if ipctk is missing, or if the mesh intersects or touches itself.
    """

    def __init__(
        self,
        V: FunctionSpace,
        skin: Skin | None,
        regions: Sequence[Region],
        stiffness: float | None = None,
        distance: float | None = None,
        friction: float = 0.0,
        kinematics: Kinematics = SOLID,
    ) -> None:
        super().__init__(V, skin, kinematics)
        points = self.surface.points[:, : kinematics.components]
        areas = None
        if kinematics.revolved:
            areas = point_areas(self.surface.points, self.surface.triangles, revolved=True)
        surface = CollisionSurface(points, self.surface.triangles, areas)
        self.collision_surface, self._rank = surface, V.mesh.comm.rank
        surface.check(points, "in the mesh")
        modulus = reference_modulus(V.mesh, regions)
        self.stiffness = _STIFFNESS * modulus if stiffness is None else stiffness
        self._checked, self._coefficient, self.distance = False, friction, 0.0
        self._blocks: tuple[Array, str, Blocks] | None = None
        self._set_distance(surface.default_distance(points) if distance is None else distance)
        self._narrower = 1.0  # its own distance over the present one
        # Forces of friction at the end of the last step, and where the next one starts.
        self._old: Array = np.zeros((len(self.surface.support.X), kinematics.components))
        self._origin = np.zeros_like(self._old)
        self._next: Array | None = None

    def set_load(self, load: float) -> None:
        """Start friction in the step to this load, of which `begin_step` gave the start."""
        if self._next is not None:
            self._energy.lag(self._next)
            self._next = self._blocks = None

    def scale_penalties(self, factor: float) -> bool:
        """Divide the distance, to which the gap at a given pressure is in proportion.

        The distance is at most the barrier's own, as a larger one may exceed gaps at rest. Return
        whether the factor changes anything: on a path, which asks by 1, the barrier stays.
        """
        before, self._narrower = self._narrower, max(1.0, factor * self._narrower)
        self._set_distance(self.distance * before / self._narrower)
        return self._narrower != before

    @property
    def length_text(self) -> str:
        """See `fem_snh.terms.term.Term.length_text`."""
        return f"the barrier of self-contact acts from {self.distance:.3g} m"

    def share_lengths(self, other: Self) -> None:
        """Take over the distance of the same barrier on another space."""
        self._set_distance(other.distance)

    def _set_distance(self, distance: float) -> None:
        """Set the distance at which contact begins [m], in a state without friction."""
        if distance != self.distance:
            self.distance = distance
            values = self.stiffness, distance, self._coefficient
            self._energy, self._blocks = BarrierEnergy(self.collision_surface, *values), None
            self.pairs = [self._energy]

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to this rank's own entries of ``r_u``. Collective."""
        super().add_residual(u, p, r_u, r_p)
        if self._next is not None:
            self.surface.support.add_own(self._old, self._rows(r_u))

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        x = self.configuration(u)
        blocks = self._hessian(x, self._blocks[1] if self._blocks else "clamp")
        if not self._matrix.contains(blocks):
            pattern = self._matrix.blocks(self._energy.pattern(x))
            self._matrix.replace(blocks, pattern)
        return self._matrix.pairs

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the filtered Hessian; return the number of collisions, on rank 0. Collective.

        Nearly every collision has a negative eigenvalue, that of a motion around its normal.
        """
        x = self.configuration(u)
        self._matrix.add(self._hessian(x, choose("filter", filter, FILTERS)), target)
        return len(self._energy.collisions(x)) if self._rank == 0 else 0

    def largest_step(self, u: Array, d: Array) -> float:
        """Return the part of a step before its first collision: see `StepLimitingTerm`."""
        x = np.asfortranarray(self.surface.positions(u))
        moved = self.surface.interpolate(self.surface.support.gather(d))
        return self.collision_surface.largest_step(x, moved)

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return the row of run.json. Collective.

        ``pairs`` in contact; ``distance`` [m], the smallest, or None without a pair; ``force`` [N],
        half of the sum of the magnitudes of the points' forces; ``bodies``, the force [N] of
        contact on each connected part of the surface, and ``friction``, its part of it;
        ``stiffness`` [Pa]; ``activation`` [m], the distance at which contact begins.
        """
        x = self.configuration(u)
        collisions, forces = self._energy.collisions(x), -self._energy.gradient(x)
        smallest = self.collision_surface.smallest_distance(x, self.distance)
        row = {
            "pairs": len(collisions),
            "distance": smallest if len(collisions) else None,
            "force": float(np.linalg.norm(forces, axis=1).sum() / 2),
            "bodies": self.collision_surface.sums(forces),
            "stiffness": self.stiffness,
            "activation": self.distance,
        }
        if self._energy.friction:
            row["friction"] = self.collision_surface.sums(-self._energy.friction_gradient(x))
        return {"self_contact": row}

    def begin_step(self, u: PETSc.Vec) -> None:
        """Start a step from a state; the first one must not intersect itself. Collective.

        Until `set_load` the forces of friction are those at the end of the last step: an integrator
        that weights the forces of both ends of a step evaluates them here.

        Raises
        ------
        BadInput
            On every rank, if the first state does.
        """
        x = self.configuration(u)
        if not self._checked:
            self.collision_surface.check(x, "at the start")
        self._checked = True
        self._energy.begin_step(x)
        self._origin = self.surface.support.gather(self._nodal(u))
        self._next, self._blocks = x, None

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Update the normal forces of friction; return the change of its forces. Collective.

        Raises
        ------
        NotSettled
            On every rank, if the surface intersects itself after all.
        """
        x = self.configuration(u)
        if self.collision_surface.intersects(x):
            raise NotSettled("the surface intersects itself")
        ratio = self._energy.settle(x)
        if not ratio <= 1:
            self._blocks = None
        return LaggedChange(ratio, "self_contact: the change of friction's forces")

    def end_step(self, u: PETSc.Vec) -> None:
        """Keep the forces of friction, and leave its energy out: it is dissipated. Collective."""
        self._energy.ended = True
        if self._coefficient:
            self._old = self._friction_forces(u)

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return 0 and what friction dissipated in the step [J]: see `WorkingTerm`. Collective."""
        if not self._coefficient:
            return 0.0, 0.0
        forces = end_weight * self._friction_forces(u) + (1 - end_weight) * self._old
        return 0.0, float(
            (forces * (self.surface.support.gather(self._nodal(u)) - self._origin)).sum()
        )

    def history(self) -> tuple[Array, Array]:
        """Return this rank's nodes (n, 3) and the forces of friction there (n, 3)."""
        own = self.surface.support.is_own if self._coefficient else slice(0)
        return self.surface.support.X[own], self._old[own]

    def set_history(self, values: Array) -> None:
        """Set the forces of friction, in the order of `history`. Collective."""
        if self._coefficient:
            parts = self.surface.support.comm.allgather(
                np.asarray(values).reshape(-1, self._old.shape[1])
            )
            self._old = np.concatenate(parts)

    def _friction_forces(self, u: PETSc.Vec) -> Array:
        """Return the derivative of friction's energy by the nodes, (m, 3). Collective."""
        return self.surface.nodal(self._energy.friction_gradient(self.configuration(u)))

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return the positions of the surface's points (n, dim), in Fortran order. Collective."""
        return np.asfortranarray(super().configuration(u))

    def _hessian(self, x: Array, filter: str) -> Blocks:
        """Return the filtered Hessian's blocks, of the last call if it was for the same."""
        last = self._blocks
        if last is None or last[1] != filter or not np.array_equal(last[0], x):
            last = self._blocks = x, filter, self._matrix.blocks(self._energy.hessian(x, filter))
        return last[2]


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


class LaggedFriction(NamedTuple):
    r"""The energy of friction of k collisions in a step, of the slip since its start.

    With the lagged normal force :math:`\ell_k` and tangent plane of a collision, on which
    :math:`T_k` projects,

    .. math:: E = \sum_k \mu \ell_k f_0(|s_k|), \qquad
        f_0'(y) = \begin{cases} 2 y/\epsilon - y^2/\epsilon^2 & y < \epsilon \\ 1 \end{cases}

    (Li et al. 2020, eq. 13 to 16). The slip is :math:`s_k = T_k (r_k - c_k r_k^0)`, with the
    vector r between the closest points of both parts and the same vector at the start of the step,
    which :math:`c_k \le 1` shortens to the lagged distance along the lagged normal: an approach is
    no slip. With :math:`c_k = 1` it is one as soon as the normal tilts; where the parts stick, the
    next solve tilts the normal back by the ratio of both distances, and the step does not settle.

    Attributes
    ----------
    matrix : (k d, n d) sparse
        From the coordinates of points to relative positions in the tangent planes.
    offset : (k, d)
        Relative positions from which the slip counts [m].
    limit : (k,)
        Coulomb's limit of the force, mu times the lagged normal force [N].
    width : float
        The slip epsilon below which the parts stick [m].
    """

    matrix: Any
    offset: Array
    limit: Array
    width: float

    def energy(self, x: Array) -> float:
        """Return the energy [J] at points x (n, d)."""
        (_, y), width = self._slip(x), self.width
        sticking = y**2 / width - y**3 / (3 * width**2) + width / 3
        return float(self.limit @ np.where(y < width, sticking, y))

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative [N] by the points, (n, d)."""
        slip, y = self._slip(x)
        forces = (self.limit * self._factor(y))[:, None] * slip
        return np.asarray(self.matrix.T @ forces.ravel()).reshape(x.shape)

    def hessian(self, x: Array) -> Any:
        """Return the second derivative [N/m], a sparse (d n, d n) matrix without negative values.

        The energy is convex.
        """
        slip, y = self._slip(x)
        unit = slip / np.where(y > 0, y, 1.0)[:, None]
        # f_0'' - f_0'/y
        along = np.where(y < self.width, -y / self.width**2, -1 / np.maximum(y, self.width))
        blocks = self._factor(y)[:, None, None] * np.eye(slip.shape[1])
        blocks += along[:, None, None] * unit[:, :, None] * unit[:, None, :]
        blocks *= self.limit[:, None, None]
        middle = bsr_matrix((blocks, np.arange(len(y)), np.arange(len(y) + 1)))
        return (self.matrix.T @ middle @ self.matrix).tocsc()

    def _slip(self, x: Array) -> tuple[Array, Array]:
        """Return the slip at points x (n, d), (k, d) [m], and its length, (k,)."""
        slip = np.asarray((self.matrix @ x.ravel()).reshape(self.offset.shape) - self.offset)
        return slip, np.linalg.norm(slip, axis=1)

    def _factor(self, y: Array) -> Array:
        """Return f_0'(y) / y."""
        width = self.width
        return np.where(y < width, 2 / width - y / width**2, 1 / np.maximum(y, width))


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
    friction : LaggedFriction or None
        The friction of a step; None without any.
    ended : bool
        Whether no step has begun since the last one: friction has dissipated its energy then.
    """

    def __init__(
        self, surface: CollisionSurface, stiffness: float, distance: float, friction: float
    ) -> None:
        self._surface, self._distance, self._coefficient = surface, distance, friction
        self._barrier = surface.ipctk.BarrierPotential(distance, stiffness, True)
        self.friction: LaggedFriction | None = None
        self._start: Array = np.zeros(0)
        self._last: tuple[Array, Any] | None = None
        self.ended = False

    def collisions(self, x: Array) -> Any:
        """Return the ipctk.NormalCollisions at points x, of the last call if x is the same."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x, self._surface.collisions(x, self._distance)
        return self._last[1]

    def energy(self, x: Array) -> float:
        """Return the energy of the barrier and, within a step, of friction [J]."""
        energy = float(self._barrier(self.collisions(x), self._surface.mesh, x))
        return energy + self.friction.energy(x) if self.friction and not self.ended else energy

    def gradient(self, x: Array) -> Array:
        """Return the derivative of the energy and of that of friction, (n, 3) [N]."""
        return self._normal_gradient(x) + self.friction_gradient(x)

    def friction_gradient(self, x: Array) -> Array:
        """Return the derivative of the energy of friction, (n, 3) [N]."""
        return self.friction.gradient(x) if self.friction else np.zeros(x.shape)

    def hessian(self, x: Array, filter: str) -> Any:
        """Return the filtered second derivative [N/m], a sparse (3 n, 3 n) matrix."""
        methods = self._surface.ipctk.PSDProjectionMethod
        method = {"exact": methods.NONE, "clamp": methods.CLAMP, "abs": methods.ABS}[filter]
        found = self._barrier.hessian(self.collisions(x), self._surface.mesh, x, method)
        return found + self.friction.hessian(x) if self.friction else found

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
        self._last, self.ended = None, False
        self._start, self.friction = np.array(x), None

    def lag(self, x: Array) -> None:
        """Set normal forces, tangents and the origin of slip to those of collisions at x."""
        self.friction = self._lagged(x)

    def settle(self, x: Array) -> float:
        """Update the normal forces of friction; return the change of its forces, in its tolerance.

        They are kept where the change is below the tolerance.
        """
        before, lagged = self.friction_gradient(x), self._lagged(x)
        after = lagged.gradient(x) if lagged else np.zeros(x.shape)
        change = float(np.linalg.norm(after - before))
        normal = self._coefficient * float(np.linalg.norm(self._normal_gradient(x)))
        ratio = relative(change, normal, _SETTLED)
        if not ratio <= 1:
            self.friction = lagged
        return ratio

    def _normal_gradient(self, x: Array) -> Array:
        found = self._barrier.gradient(self.collisions(x), self._surface.mesh, x)
        return np.asarray(found).reshape(x.shape)

    def _lagged(self, x: Array) -> LaggedFriction | None:
        """Return the friction of collisions at points x; None without any.

        ipctk's own tangential collisions leave out edges that are nearly parallel, whose forces
        then jump where the closest parts change.
        """
        collisions = self.collisions(x)
        count, dim = len(collisions), x.shape[1]
        if not self._coefficient > 0 or not count:
            return None
        edges, faces = self._surface.mesh.edges, self._surface.mesh.faces
        points, weights = np.zeros((count, 4), dtype=int), np.zeros((count, 4))
        limit = np.empty(count)
        for k in range(count):
            one = collisions[k]
            vertices = one.dof(x, edges, faces)
            size = len(vertices) // dim
            points[k, :size] = one.vertex_ids(edges, faces)[:size]
            weights[k, :size] = one.compute_coefficients(vertices)
            force = self._barrier.force_magnitude(one.compute_distance(vertices), one.dmin)
            smooth = one.mollifier(vertices) if one.is_mollified() else 1.0
            limit[k] = self._coefficient * one.weight * smooth * force
        start, end = (np.einsum("ki,kid->kd", weights, at[points]) for at in (self._start, x))
        distance = np.linalg.norm(end, axis=1)
        normal = end / distance[:, None]
        shorter = distance / np.maximum((start * normal).sum(axis=1), distance)
        tangential = np.eye(dim) - normal[:, :, None] * normal[:, None, :]
        offset = shorter[:, None] * np.einsum("kde,ke->kd", tangential, start)
        values = np.einsum("kde,ki->kdie", tangential, weights)
        columns = np.broadcast_to(
            dim * points[:, None, :, None] + np.arange(dim), values.shape
        ).ravel()
        indptr = np.arange(count * dim + 1) * 4 * dim
        matrix = csr_matrix((values.ravel(), columns, indptr), shape=(count * dim, x.size))
        return LaggedFriction(matrix, offset, limit, _STICKING * self._distance)
