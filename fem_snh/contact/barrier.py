"""The term of self-contact by a barrier: incremental potential contact (IPC, Li et al. 2020).

Only this module calls ipctk, whose API changes between minor versions. ipctk expects vertices as
rows of arrays in Fortran order, and returns squared distances.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

from petsc4py import PETSc

import numpy as np
from scipy.sparse import csgraph, csr_matrix

from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region, reference_modulus
from fem_snh.choices import FILTERS
from fem_snh.contact.gathered_surface import Blocks, point_areas
from fem_snh.contact.ipctk_import import import_ipctk
from fem_snh.contact.surface_contact import SelfContactTerm
from fem_snh.errors import BadInput, NotSettled, choose
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.terms.history import LaggedChange
from fem_snh.terms.term import StepLimitingTerm

#: Default stiffness over the materials' modulus E: at a contact pressure of E about half of the
#: activation distance is left.
_STIFFNESS = 0.1


class IPC(SelfContactTerm, StepLimitingTerm):
    """Self-contact by the barrier of `CollisionSurface`. Collective.

    The energy is infinite where surfaces touch. `largest_step` limits each step of Newton's method
    to less than its first collision, so that the surface never intersects itself. Every rank
    evaluates the whole surface and adds the rows that it owns.

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
        A solid, a plane, or axisymmetric without torsion.

    Attributes
    ----------
    collision_surface : CollisionSurface
        The surface with its barrier.
    stiffness, distance : float
        The parameters; `scale_penalties` changes the distance.

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
        self.collision_surface = CollisionSurface(points, self.surface.triangles, areas)
        self.collision_surface.check(points, "in the mesh")
        self.pairs = [self.collision_surface]
        if stiffness is None:
            stiffness = _STIFFNESS * reference_modulus(V.mesh, regions)
        if distance is None:
            distance = self.collision_surface.default_distance(points)
        self.stiffness, self._checked = stiffness, False
        self._set_distance(distance)
        self._narrower = 1.0  # the initial distance over the present one

    def scale_penalties(self, factor: float) -> bool:
        """Divide the activation distance by ``factor``; return whether the distance changes.

        At a given pressure the gap is proportional to the distance. The distance does not exceed
        its initial value, as it could then exceed gaps in the mesh.
        """
        before, self._narrower = self._narrower, max(1.0, factor * self._narrower)
        self._set_distance(self.distance * before / self._narrower)
        return self._narrower != before

    @property
    def length_text(self) -> str:
        """The activation distance, for messages."""
        return f"the barrier of self-contact acts from {self.distance:.3g} m"

    def share_lengths(self, other: Self) -> None:
        """Set the activation distance to that of ``other``, the same term on another space."""
        self._set_distance(other.distance)

    def _set_distance(self, distance: float) -> None:
        """Set the activation distance [m], and discard the cached Hessian."""
        self.distance = distance
        self._blocks: tuple[Array, str, Blocks] | None = None
        self.collision_surface.set_barrier(self.stiffness, distance)

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        x = self.configuration(u)
        blocks = self._hessian(x, self._blocks[1] if self._blocks else "clamp")
        if not self._matrix.contains(blocks):
            pattern = self._matrix.blocks(self.collision_surface.pattern(x))
            self._matrix.replace(blocks, pattern)
        return self._matrix.pairs

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add this rank's rows of the filtered Hessian. Collective.

        Return the number of collisions on rank 0, and 0 on other ranks: nearly every collision has
        a negative eigenvalue, for a rotation about its normal, that is filtered.
        """
        x = self.configuration(u)
        self._matrix.add(self._hessian(x, choose("filter", filter, FILTERS)), target)
        return len(self.collision_surface.collisions(x)) if self.comm.rank == 0 else 0

    def largest_step(self, u: Array, d: Array) -> float:
        """Return the fraction of a step ``d`` from ``u`` that is free of collisions.

        See `CollisionSurface.largest_step` and `fem_snh.terms.term.StepLimitingTerm`. Collective.
        """
        x = np.asfortranarray(self.surface.positions(u))
        moved = self.surface.interpolate(self.surface.support.gather(d))
        return self.collision_surface.largest_step(x, moved)

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return ``{"self_contact": row}`` for run.json. Collective.

        ``pairs``, the number of collisions; ``distance`` [m], the smallest, or None without a pair;
        ``force`` [N], half of the sum of the magnitudes of the points' forces; ``bodies``, the
        contact force [N] on each connected part of the surface; ``stiffness`` [Pa]; ``activation``
        [m], the distance at which contact begins.
        """
        x, surface = self.configuration(u), self.collision_surface
        pairs, forces = len(surface.collisions(x)), -surface.gradient(x)
        row = {
            "pairs": pairs,
            "distance": surface.smallest_distance(x, self.distance) if pairs else None,
            "force": float(np.linalg.norm(forces, axis=1).sum() / 2),
            "bodies": surface.sums(forces),
            "stiffness": self.stiffness,
            "activation": self.distance,
        }
        return {"self_contact": row}

    def begin_step(self, u: PETSc.Vec) -> None:
        """Check the state ``u`` at the start of the first step; do nothing later. Collective.

        Raises
        ------
        BadInput
            On every rank, if the surface intersects or touches itself there.
        """
        if not self._checked:
            self.collision_surface.check(self.configuration(u), "at the start")
            self._checked = True

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Return a change of 0, as nothing is lagged. Collective.

        Raises
        ------
        NotSettled
            On every rank, if the surface intersects itself after all.
        """
        if self.collision_surface.intersects(self.configuration(u)):
            raise NotSettled("the surface intersects itself")
        return LaggedChange()

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return the points' positions (n, dim) [m], a copy in Fortran order. Collective."""
        return np.asfortranarray(super().configuration(u))

    def _hessian(self, x: Array, filter: str) -> Blocks:
        """Return the filtered Hessian at ``x`` in this rank's rows; the last one is cached."""
        last = self._blocks
        if last is None or last[1] != filter or not np.array_equal(last[0], x):
            hessian = self.collision_surface.hessian(x, filter)
            last = self._blocks = x, filter, self._matrix.blocks(hessian)
        return last[2]


#: Default activation distance, in mean lengths of the surface's edges.
_DISTANCE = 0.1
#: The default is at most this fraction of the smallest distance in the mesh, where nothing touches.
_OF_SMALLEST = 0.9
#: Parts of the surface that are closer than this, in edges, touch: an error at the start.
_TOUCHING = 1e-4
#: Iterations of CCD for one pair, after which the length reached so far is taken, which is free of
#: collisions. ipctk's default is ten million: parts that slide along each other by far more than
#: their distance take as many as the ratio of both.
_CCD_ITERATIONS = 1000
#: Longest step [m] that ipctk gets: it squares distances, and does not return where they overflow.
_LARGEST = 1e140
#: The sparsity pattern has all pairs within this many activation distances.
_PATTERN = 2.0


class CollisionSurface:
    r"""A closed surface, of one or several bodies, that must not intersect itself. Not collective.

    Points, edges and triangles that share a point are no pair. The energy is

    .. math:: E = \kappa \hat d \sum_k w_k\, b(d_k/\hat d), \qquad
        b(s) = -(s^2 - 1)^2 \ln s^2 \quad \text{for}\ s < 1

    over pairs k of points, edges and triangles, with distance d_k and area w_k (Li et al. 2020, eq.
    6; Li et al. 2023 for the areas), stiffness :math:`\kappa` [Pa] and activation distance
    :math:`\hat d` [m]. `set_barrier` must be called first. Positions ``x`` of the points are (n,
    dim) [m].

    Parameters
    ----------
    points : (n, dim)
        Reference positions [m].
    triangles : (m, dim) int32
        The points of each triangle; in two dimensions of each segment.
    areas : (n,), optional
        The area of each point [m^2]. Default: ipctk's, from the triangles, or from the segments per
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
            edges = triangles
            self.mesh = self.ipctk.CollisionMesh(_rows(points), edges)
        else:
            edges = self.ipctk.edges(triangles)
            self.mesh = self.ipctk.CollisionMesh(_rows(points), edges, triangles)
        if areas is not None:
            self.mesh.vertex_areas = areas
        a, b = edges.T
        self.edge_length = float(np.linalg.norm(points[a] - points[b], axis=1).mean())
        graph = csr_matrix((np.ones(len(a)), (a, b)), shape=(len(points),) * 2)
        self.bodies = csgraph.connected_components(graph, directed=False)[1]
        # Additive CCD (Li et al. 2021, section 4) is conservative. ipctk's default, an interval
        # search, takes up to 100 times as long where faces approach each other in parallel.
        self._ccd = self.ipctk.AdditiveCCD(_CCD_ITERATIONS)

    def set_barrier(self, stiffness: float, distance: float) -> None:
        """Set the barrier's stiffness [Pa] and activation distance [m]; discard the collisions."""
        self._distance = distance
        self._barrier = self.ipctk.BarrierPotential(distance, stiffness, True)
        self._last: tuple[Array, Any] | None = None

    def collisions(self, x: Array) -> Any:
        """Return the ipctk.NormalCollisions, pairs within the activation distance, at x; cached."""
        if self._last is None or not np.array_equal(self._last[0], x):
            self._last = x, self._find(x, self._distance)
        return self._last[1]

    def energy(self, x: Array) -> float:
        """Return the energy [J]."""
        return float(self._barrier(self.collisions(x), self.mesh, x))

    def gradient(self, x: Array) -> Array:
        """Return the energy's derivative by the positions of the points, (n, dim) [N]."""
        found = self._barrier.gradient(self.collisions(x), self.mesh, x)
        return np.asarray(found).reshape(x.shape)

    def hessian(self, x: Array, filter: str) -> Any:
        """Return the Hessian, filtered pair by pair, a sparse (dim n, dim n) matrix [N/m]."""
        methods = self.ipctk.PSDProjectionMethod
        method = {"exact": methods.NONE, "clamp": methods.CLAMP, "abs": methods.ABS}[filter]
        return self._barrier.hessian(self.collisions(x), self.mesh, x, method)

    def pattern(self, x: Array) -> Any:
        """Return a sparse matrix of ones where a barrier twice as wide has a Hessian at x."""
        wide = _PATTERN * self._distance
        barrier = self.ipctk.BarrierPotential(wide, 1.0, True)
        found = barrier.hessian(self._find(x, wide), self.mesh, x)
        found.data[:] = 1.0
        return found

    def smallest_distance(self, x: Array, reach: float) -> float:
        """Return the smallest distance [m] of parts that share no point; inf beyond ``reach``."""
        found = self._find(x, reach).compute_minimum_distance(self.mesh, _rows(x))
        return float(np.sqrt(found))

    def sums(self, forces: Array) -> list[list[float]]:
        """Return the sum of the points' forces (n, dim) on each body, three components [N]."""
        sums = np.zeros((self.bodies.max() + 1, 3))
        np.add.at(sums[:, : forces.shape[1]], self.bodies, forces)
        return sums.tolist()

    def default_distance(self, points: Array) -> float:
        """Return the default activation distance [m] for reference positions (n, dim)."""
        wanted = _DISTANCE * self.edge_length
        return min(wanted, _OF_SMALLEST * self.smallest_distance(points, wanted / _OF_SMALLEST))

    def check(self, x: Array, where: str) -> None:
        """Raise BadInput if the surface at points x intersects or touches itself.

        ``where`` completes the message: "in the mesh", "at the start".
        """
        least = _TOUCHING * self.edge_length
        distance = 0.0 if self.intersects(x) else self.smallest_distance(x, least)
        if distance < least:
            raise BadInput(
                "self_contact.method = 'ipc': expected a surface that neither intersects nor "
                f"touches itself {where}; the smallest distance of parts without a common node is "
                f"{distance:.3g}, less than {least:.3g}"
            )

    def intersects(self, x: Array) -> bool:
        """Return whether the surface at positions x (n, dim) intersects itself."""
        return bool(self.ipctk.has_intersections(self.mesh, _rows(x)))

    def largest_step(self, x: Array, d: Array) -> float:
        """Return a number in [0, 1] such that x + s d has no collision for smaller s.

        It is 1 if the whole step has no collision, otherwise about 0.9 of the first collision's s.
        It is 0 if d is not finite, as ipctk would not return.
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

    def _find(self, x: Array, distance: float) -> Any:
        """Return the ipctk.NormalCollisions within a distance [m] at positions x (n, dim).

        They are weighted by areas (Li et al. 2023), so that a pressure depends on the distance and
        little on the mesh. ipctk's improved max approximation would remove the dependence on the
        mesh, but its energy jumps where the closest parts change, and a line search stops there.
        """
        found = self.ipctk.NormalCollisions()
        found.use_area_weighting = True
        found.build(self.mesh, _rows(x), distance)
        return found


def _rows(x: Array) -> Array:
    """Return positions as ipctk expects them: float, in Fortran order."""
    return np.asfortranarray(x, dtype=float)
