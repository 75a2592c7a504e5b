"""Self-contact by a barrier: surfaces that never intersect (incremental potential contact).

Only this module imports ipctk, whose API changes between minor versions. Its vertices are rows of
arrays in Fortran order, its distances are squared.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any, Self

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.sparse import csgraph, csr_matrix

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
from fem_snh.terms.term import LaggedChange, StepLimitingTerm

Array = npt.NDArray[Any]

#: Default stiffness in the materials' modulus: a contact pressure of E leaves about half of the
#: activation distance.
_STIFFNESS = 0.1


class IPC(SelfContactTerm, StepLimitingTerm):
    """Self-contact by a barrier: the term of `BarrierEnergy`. Collective.

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
        self._checked, self.distance = False, 0.0
        self._blocks: tuple[Array, str, Blocks] | None = None
        self._set_distance(surface.default_distance(points) if distance is None else distance)
        self._narrower = 1.0  # its own distance over the present one

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
        """Set the distance at which contact begins [m]."""
        if distance != self.distance:
            self.distance, self._blocks = distance, None
            self._energy = BarrierEnergy(self.collision_surface, self.stiffness, distance)
            self.pairs = [self._energy]

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
        contact on each connected part of the surface; ``stiffness`` [Pa]; ``activation`` [m], the
        distance at which contact begins.
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
        return {"self_contact": row}

    def begin_step(self, u: PETSc.Vec) -> None:
        """Start a step from a state; the first one must not intersect itself. Collective.

        Raises
        ------
        BadInput
            On every rank, if the first state does.
        """
        x = self.configuration(u)
        if not self._checked:
            self.collision_surface.check(x, "at the start")
        self._checked, self._blocks = True, None
        self._energy.begin_step()

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Return no change: nothing is lagged. Collective.

        Raises
        ------
        NotSettled
            On every rank, if the surface intersects itself after all.
        """
        if self.collision_surface.intersects(self.configuration(u)):
            raise NotSettled("the surface intersects itself")
        return LaggedChange()

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


#: The sparsity pattern has all pairs within this many activation distances.
_PATTERN = 2.0


class BarrierEnergy:
    r"""The energy of a barrier between all parts of a surface. Not collective.

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
    """

    def __init__(self, surface: CollisionSurface, stiffness: float, distance: float) -> None:
        self._surface, self._distance = surface, distance
        self._barrier = surface.ipctk.BarrierPotential(distance, stiffness, True)
        self._last: tuple[Array, Any] | None = None

    def collisions(self, x: Array) -> Any:
        """Return the ipctk.NormalCollisions at points x, of the last call if x is the same."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x, self._surface.collisions(x, self._distance)
        return self._last[1]

    def energy(self, x: Array) -> float:
        """Return the energy [J]."""
        return float(self._barrier(self.collisions(x), self._surface.mesh, x))

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the points, (n, 3) [N]."""
        found = self._barrier.gradient(self.collisions(x), self._surface.mesh, x)
        return np.asarray(found).reshape(x.shape)

    def hessian(self, x: Array, filter: str) -> Any:
        """Return the filtered second derivative [N/m], a sparse (3 n, 3 n) matrix."""
        methods = self._surface.ipctk.PSDProjectionMethod
        method = {"exact": methods.NONE, "clamp": methods.CLAMP, "abs": methods.ABS}[filter]
        return self._barrier.hessian(self.collisions(x), self._surface.mesh, x, method)

    def pattern(self, x: Array) -> Any:
        """Return a sparse matrix of ones, where the Hessian of a wider barrier has entries."""
        wide = _PATTERN * self._distance
        barrier = self._surface.ipctk.BarrierPotential(wide, 1.0, True)
        found = barrier.hessian(self._surface.collisions(x, wide), self._surface.mesh, x)
        found.data[:] = 1.0
        return found

    def begin_step(self) -> None:
        """Search candidates again, so that a resumed run adds in the order of the whole one."""
        self._surface.forget()
        self._last = None
