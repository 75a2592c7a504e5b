"""Self-contact by a barrier: surfaces that never intersect (incremental potential contact)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region, reference_modulus
from fem_snh.assembly.unknowns import local_values, writable_values
from fem_snh.choices import FILTERS
from fem_snh.contact.collisions import BarrierEnergy, CollisionSurface
from fem_snh.contact.embedded_surface import Blocks, point_areas
from fem_snh.contact.fields import SelfContactTerm
from fem_snh.errors import NotSettled, choose
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.terms.history import WorkingTerm
from fem_snh.terms.settling import LaggedChange
from fem_snh.terms.step_limit import StepLimitingTerm

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
        V: Any,
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
        self.distance = surface.default_distance(points) if distance is None else distance
        self._energy = BarrierEnergy(surface, self.stiffness, self.distance, friction)
        self._checked, self._ended, self._coefficient = False, False, friction
        self._narrower = 1.0  # its own distance over the present one
        # Forces of friction at the end of the last step, and where the next one starts.
        self._old: Array = np.zeros((len(self.surface.support.X), kinematics.components))
        self._origin = np.zeros_like(self._old)
        self._next: Array | None = None
        self._blocks: tuple[Array, str, Blocks] | None = None

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
            values = self.stiffness, distance, self._coefficient
            self._energy, self._blocks = BarrierEnergy(self.collision_surface, *values), None
            self.distance = distance

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of the barrier and, within a step, of friction [J]. Collective."""
        x = self._positions(u)
        energy = self._energy.energy(x)
        return energy if self._ended else energy + self._energy.friction.energy(x)

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to this rank's own entries of ``r_u``. Collective."""
        forces = self._matrix.nodal(self._energy.gradient(self._positions(u)))
        if self._next is not None:
            forces += self._old
        self.surface.support.add_own(forces, writable_values(r_u).reshape(-1, self._old.shape[1]))

    def couplings(self, u: PETSc.Vec) -> Array:
        """Return the pairs of nodes that the Hessian couples: see `CouplingTerm`. Collective."""
        x = self._positions(u)
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
        x = self._positions(u)
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
        x = self._positions(u)
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
        if self._energy.friction.acts:
            row["friction"] = self.collision_surface.sums(-self._energy.friction.gradient(x))
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
        x = self._positions(u)
        if not self._checked:
            self.collision_surface.check(x, "at the start")
        self._checked, self._ended = True, False
        self._energy.begin_step(x)
        self._origin = self._nodal_displacement(u)
        self._next, self._blocks = x, None

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Update the normal forces of friction; return the change of its forces. Collective.

        Raises
        ------
        NotSettled
            On every rank, if the surface intersects itself after all.
        """
        x = self._positions(u)
        if self.collision_surface.intersects(x):
            raise NotSettled("the surface intersects itself")
        ratio = self._energy.settle(x)
        if not ratio <= 1:
            self._blocks = None
        return LaggedChange(ratio, "self_contact: the change of friction's forces")

    def end_step(self, u: PETSc.Vec) -> None:
        """Keep the forces of friction, and leave its energy out: it is dissipated. Collective."""
        self._ended = True
        if self._coefficient:
            self._old = self._friction_forces(u)

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return 0 and what friction dissipated in the step [J]: see `WorkingTerm`. Collective."""
        if not self._coefficient:
            return 0.0, 0.0
        forces = end_weight * self._friction_forces(u) + (1 - end_weight) * self._old
        return 0.0, float((forces * (self._nodal_displacement(u) - self._origin)).sum())

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
        return self._matrix.nodal(self._energy.friction.gradient(self._positions(u)))

    def _nodal_displacement(self, u: PETSc.Vec) -> Array:
        """Return the displacement of the nodes, (m, 3). Collective."""
        return self.surface.support.gather(local_values(u).reshape(-1, self._old.shape[1]))

    def _positions(self, u: PETSc.Vec) -> Array:
        """Return the points of the surface (n, 3), in Fortran order. Collective."""
        values = local_values(u).reshape(-1, self._old.shape[1])
        return np.asfortranarray(self.surface.positions(values))

    def _hessian(self, x: Array, filter: str) -> Blocks:
        """Return the filtered Hessian's blocks, of the last call if it was for the same."""
        last = self._blocks
        if last is None or last[1] != filter or not np.array_equal(last[0], x):
            last = self._blocks = x, filter, self._matrix.blocks(self._energy.hessian(x, filter))
        return last[2]
