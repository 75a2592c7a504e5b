"""The energy of contact between surfaces: what obstacles, bodies and self-contact share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.unknowns import local_values, update_ghosts, writable_values
from fem_snh.contact.gathered_surface import (
    EmbeddedSurface,
    SurfaceMatrix,
    embedded_surface,
    point_areas,
)
from fem_snh.contact.law import ContactLaw
from fem_snh.contact.surface_quadrature import DeepestPoint
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.records.output_fields import CONTACT_PRESSURES
from fem_snh.terms.history import HistoryTerm, LaggedChange, largest_change
from fem_snh.terms.term import CouplingTerm, ForceTerm

if TYPE_CHECKING:
    from fem_snh.contact.body_contact import SurfacePair
    from fem_snh.contact.obstacle_pair import ObstaclePair


Array = npt.NDArray[Any]


class ContactPair(ABC):
    """Two surfaces that may touch, and the law of their points.

    A subclass has energy, gradient, and nodal forces of one surface. Methods get the configuration
    ``x`` of `SurfaceContact.configuration`, and return what this rank adds to the sum of all ranks,
    or all of it where every rank has all points.

    Parameters
    ----------
    name : str
        Name in run.json.
    law : ContactLaw
        The law.

    Attributes
    ----------
    mean_weight : float or None
        Weight of the energy of a step's mean forces, in place of the energy of the present ones:
        see `fem_snh.terms.term.MeanForceTerm`.
    """

    def __init__(self, name: str, law: ContactLaw) -> None:
        self.name, self.law = name, law
        self.mean_weight: float | None = None

    @property
    def weight(self) -> float:
        """The weight of the energy."""
        return 1.0 if self.mean_weight is None else self.mean_weight

    def weight_mean_forces(self, weight: float | None) -> None:
        """Set ``mean_weight``."""
        self.mean_weight = weight

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of penalties; return whether there are any."""
        return self.law.scale_penalty(factor)

    @abstractmethod
    def acting(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the points in contact, by their rows in the law, their gaps and pressures."""

    @abstractmethod
    def nodal_forces(self, x: Array) -> Array:
        """Return the forces on the nodes of the body, or of the first surface [N], (n, 3)."""

    @abstractmethod
    def deepest(self, x: Array, search: bool) -> DeepestPoint:
        """Return the deepest point; with ``search`` wherever it is between quadrature points."""

    def row(self, x: Array) -> dict[str, Any]:
        """Return the pair's row of run.json. Collective.

        ``force`` [N] on the body, or on the first surface; ``contacts``, the number of quadrature
        points in contact; ``penetration`` [m], their largest; ``deepest`` and ``deepest_at`` of
        `DeepestPoint.row`.
        """
        (_, gap, pressure), comm = self.acting(x), self.law.comm
        force = self.nodal_forces(x).sum(axis=0)
        sums = comm.allreduce(np.array([*force, (pressure > 0).sum()])).tolist()
        depth = max(0.0, -gap.min(initial=0.0))  # max: not -0.0
        penetration = float(comm.allreduce(depth, op=MPI.MAX))
        # Without a force the depth must be found wherever it is; with one the grid's points do.
        deepest = DeepestPoint.deepest(comm.allgather(self.deepest(x, search=sums[3] == 0)))
        row = {"force": sums[:3], "contacts": int(sums[3]), "penetration": penetration}
        return row | deepest.row(penetration)

    def end_step(self, x: Array) -> None:
        """Keep the multipliers: the step is accepted."""
        if self.law.augmented:
            self.law.end_step(*self.acting(x))


class SurfaceContact(HistoryTerm, ForceTerm):
    """The energy of contact of several pairs. Collective.

    A subclass finds the surfaces and makes the pairs. Lagged quantities, such as multipliers, are
    constant in a solve and updated after it, and the step is solved again until they have settled.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    kinematics : Kinematics
        That of the displacement.

    Attributes
    ----------
    pairs : sequence of ContactPair
        The pairs.
    """

    pairs: Sequence[ObstaclePair] | Sequence[SurfacePair]

    has_penalties = is_contact = True
    #: The key of the pairs' rows in run.json.
    key = "contacts"
    #: Whether every rank has all points of ``surface``, and adds its own rows.
    gathered = False
    surface: Any

    def __init__(self, V: FunctionSpace, kinematics: Kinematics) -> None:
        self.comm, self._V, self._kinematics = V.mesh.comm, V, kinematics

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return what the pairs get of the displacement: (nodes, 3). Collective."""
        return self._kinematics.padded(local_values(u))

    def add_nodal(self, values: Array, vector: PETSc.Vec) -> None:
        """Add vectors at the rows of the configuration (n, c) to a vector: its own entries or all.

        Collective.
        """
        out = self._rows(vector)
        if self.gathered:
            self.surface.add_own(values, out)
        else:
            out += values[:, : out.shape[1]]

    def _sum(self, values: Any) -> Any:
        """Return the sum of what the ranks have of the pairs."""
        return values if self.gathered else self.comm.allreduce(values, op=MPI.SUM)

    def _rows(self, vector: PETSc.Vec) -> Array:
        """Return a vector's values at this rank's nodes, ghosts included, (nodes, components)."""
        return writable_values(vector).reshape(-1, self._kinematics.components)

    def weight_mean_forces(self, weight: float | None) -> None:
        """Set the weight of a step's mean forces: see `MeanForceTerm`."""
        for pair in self.pairs:
            pair.weight_mean_forces(weight)

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of penalties; return whether there are any."""
        return any([pair.scale_penalties(factor) for pair in self.pairs])

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of contact and friction [J]. Collective."""
        x = self.configuration(u)
        return float(self._sum(sum(pair.energy(x) for pair in self.pairs)))

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to ``r_u``: to all entries, or to own ones. Collective."""
        x = self.configuration(u)
        for pair in self.pairs:
            self.add_nodal(pair.gradient(x), r_u)

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return the rows of the pairs for run.json, by name. Collective."""
        x = self.configuration(u)
        return {self.key: {pair.name: pair.row(x) for pair in self.pairs}}

    @property
    def goals(self) -> Sequence[str]:
        """The names of the forces on first surfaces, or on the body: see `Term.goals`."""
        return [f"{pair.name}.force" for pair in self.pairs]

    def goal(self, name: str, u: PETSc.Vec) -> Array:
        """Return a force on a first surface [N]: see `Term.goals`. Collective."""
        pair, x = self.pairs[self.goals.index(name)], self.configuration(u)
        return np.asarray(self._sum(pair.nodal_forces(x).sum(axis=0)))

    def add_nodal_forces(self, name: str, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the nodal forces of a force: see `fem_snh.terms.term.ForceTerm`. Collective."""
        pair, x = self.pairs[self.goals.index(name)], self.configuration(u)
        self.add_nodal(pair.nodal_forces(x), r)

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative of a force without friction: see `Term.goals`. Collective."""
        pair, x = self.pairs[self.goals.index(name)], self.configuration(u)
        self.add_nodal(pair.force_derivative(component, x), g)

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset multipliers and friction to those of the last accepted step. Collective."""
        x = self.configuration(u)
        for pair in self.pairs:
            pair.begin_step(x)

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Update lagged quantities; return their largest change. Collective."""
        x = self.configuration(u)
        return largest_change([change for pair in self.pairs for change in pair.settle(x)])

    def end_step(self, u: PETSc.Vec) -> None:
        """Keep lagged quantities: the step is accepted."""
        x = self.configuration(u)
        for pair in self.pairs:
            pair.end_step(x)


class SelfContactTerm(SurfaceContact, CouplingTerm):
    r"""What both methods of self-contact share: the surface, its matrix, the contact pressure.

    The pressure is the force per area at the nodes. With the weights :math:`W` of the surface's
    points :math:`i` (`EmbeddedSurface`) and their areas :math:`A_i` (`point_areas`),

    .. math:: p_a = \frac{|f_a|}{\sum_i W_{ia} A_i},

    where :math:`f_a` is the nodal force of contact. The areas are those of the deformed surface,
    of the nominal pressure those at rest. At other nodes it is zero.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    skin : Skin or None
        The surface, if a lattice carries it; None for the boundary of the mesh.
    kinematics : Kinematics, optional
        That of the displacement.

    Attributes
    ----------
    surface : EmbeddedSurface
        The surface, on every rank.
    """

    name, gathered, goals = "self_contact", True, ()
    pairs: list[Any]
    surface: EmbeddedSurface

    def __init__(self, V: FunctionSpace, skin: Skin | None, kinematics: Kinematics = SOLID) -> None:
        super().__init__(V, kinematics)
        self.surface = embedded_surface(V, skin, kinematics.revolved)
        self._matrix = SurfaceMatrix(self.surface)

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return the positions of the surface's points (n, dim) [m]. Collective."""
        return self.surface.positions(self._nodal(u))

    def _nodal(self, u: PETSc.Vec) -> Array:
        """Return the displacement of this rank's nodes, ghosts included, (nodes, dim)."""
        return local_values(u).reshape(-1, self._kinematics.components)

    def end_step(self, u: PETSc.Vec) -> None:
        """Do nothing: the next step searches again."""

    def history(self) -> tuple[Array, Array]:
        """Return no points and no values: the next step depends on the displacement alone."""
        return np.empty((0, 3)), np.empty((0, 1))

    def set_history(self, values: Array) -> None:
        """Do nothing, as there is no history."""

    def nodal_field(self, name: str, u: PETSc.Vec) -> Array:
        """Return a contact pressure, 0 of another field: see `Term.nodal_field`. Collective."""
        if name not in CONTACT_PRESSURES:
            return np.zeros(1)
        forces = _dolfinx.create_vector(self._V)
        nodal = self._rows(forces)
        nodal[:] = 0
        self.add_residual(u, None, forces, None)
        x = self.surface.points
        if name == "contact_pressure":
            x = x.copy()
            x[:, : nodal.shape[1]] = self.surface.positions(self._nodal(u))
        areas, size = self._areas(x), np.linalg.norm(nodal, axis=1)
        found = np.divide(size, areas, out=np.zeros_like(size), where=areas > 0)
        nodal[:] = found[:, None]
        update_ghosts(forces)
        return np.array(self._nodal(forces)[:, 0])

    def _areas(self, x: Array) -> Array:
        """Return the areas of this rank's nodes, with the surface's points at x [m^2]."""
        points = point_areas(x, self.surface.triangles, self._kinematics.revolved)
        areas = np.zeros((sum(_dolfinx.num_nodes(self._V)), 1))
        self.surface.add_own(points[:, None], areas)
        return areas[:, 0]
