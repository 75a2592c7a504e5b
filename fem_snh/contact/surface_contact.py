"""The base classes of all contact: a pair of surfaces, and the terms that consist of pairs."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.unknowns import local_values, update_ghosts, writable_values
from fem_snh.choices import FILTERS
from fem_snh.contact.gathered_surface import (
    EmbeddedSurface,
    SurfaceMatrix,
    embedded_surface,
    point_areas,
)
from fem_snh.contact.law import ContactLaw
from fem_snh.contact.surface_quadrature import DeepestPoint
from fem_snh.errors import choose
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.records.output_fields import CONTACT_PRESSURES
from fem_snh.terms.history import HistoryTerm, LaggedChange, largest_change
from fem_snh.terms.term import CouplingTerm, ForceTerm

if TYPE_CHECKING:
    from fem_snh.contact.body_contact import SurfacePair
    from fem_snh.contact.obstacle_pair import ObstaclePair


class ContactPair(ABC):
    """Two surfaces that may touch, and the contact law at their quadrature points.

    A subclass defines the energy, its gradient, and the nodal forces on one surface. Methods get
    the array ``x`` of `SurfaceContact.configuration`, and return this rank's share of the sum over
    all ranks or, if every rank has all points, the whole sum.

    Parameters
    ----------
    name : str
        Name in run.json.
    law : ContactLaw
        Pressure as a function of the gap, at all quadrature points.

    Attributes
    ----------
    mean_weight : float or None
        Factor of the energy of a time step's mean forces (`fem_snh.terms.term.MeanForceTerm`);
        None for the energy of the present forces.
    """

    def __init__(self, name: str, law: ContactLaw) -> None:
        self.name, self.law = name, law
        self.mean_weight: float | None = None

    @property
    def weight(self) -> float:
        """The factor of the energy: ``mean_weight``, or 1 if it is None."""
        return 1.0 if self.mean_weight is None else self.mean_weight

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the penalty stiffness by ``factor`` and return True.

        With an augmented Lagrangian do nothing and return False.
        """
        return self.law.scale_penalty(factor)

    @abstractmethod
    def acting(self, x: Array) -> tuple[Array, Array, Array]:
        """Return the points in contact: rows of the law's arrays, gaps [m], pressures [Pa]."""

    @abstractmethod
    def nodal_forces(self, x: Array) -> Array:
        """Return the nodal forces on the body, or on the first surface [N], (len(x), 3)."""

    @abstractmethod
    def deepest(self, x: Array, search: bool) -> DeepestPoint:
        """Return the deepest of quadrature and grid points; with ``search`` grids may be finer."""

    def row(self, x: Array) -> dict[str, Any]:
        """Return the pair's row of run.json. Collective.

        ``force`` [N], three components, on the body or on the first surface; ``contacts``, the
        number of quadrature points with a pressure; ``penetration`` [m] >= 0, the largest at a
        quadrature point; ``deepest`` and ``deepest_at`` of `DeepestPoint.row`.
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
        """Store the multipliers, as the step is accepted."""
        if self.law.augmented:
            self.law.end_step(*self.acting(x))


class SurfaceContact(HistoryTerm, ForceTerm):
    """The energy of contact of several pairs. Collective.

    A subclass finds the surfaces and creates the pairs. Lagged quantities, such as multipliers, are
    constant during a solve and updated after it. The step is solved again until they have settled.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    kinematics : Kinematics
        Kinematics of the displacement.

    Attributes
    ----------
    pairs : sequence of ContactPair
        The pairs.
    """

    pairs: Sequence[ObstaclePair] | Sequence[SurfacePair]

    has_penalties = is_contact = True
    #: The key under which run.json has one row for each pair.
    key = "contacts"
    #: Whether every rank evaluates the whole ``surface`` and then adds only the rows that it owns.
    gathered = False
    surface: Any

    def __init__(self, V: FunctionSpace, kinematics: Kinematics) -> None:
        self.comm, self._V, self._kinematics = V.mesh.comm, V, kinematics

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return ``x`` for the pairs: here nodal displacements (local nodes, 3) [m]. Collective."""
        return self._kinematics.padded(local_values(u))

    def add_nodal(self, values: Array, vector: PETSc.Vec) -> None:
        """Add nodal vectors (n, c), rows as in `configuration`, to a ghosted vector. Collective.

        If ``gathered``, only entries that this rank owns change, otherwise ghosts too.
        """
        out = self._rows(vector)
        if self.gathered:
            self.surface.add_own(values, out)
        else:
            out += values[:, : out.shape[1]]

    def _sum(self, values: Any) -> Any:
        """Return the sum over the ranks; if ``gathered``, ``values``, which are the sum already."""
        if self.gathered:
            return values
        total = np.array(values, float)
        self.comm.Allreduce(MPI.IN_PLACE, total)
        return total

    def _rows(self, vector: PETSc.Vec) -> Array:
        """Return a writable view of a vector, ghosts included, (local nodes, components)."""
        return writable_values(vector).reshape(-1, self._kinematics.components)

    def weight_mean_forces(self, weight: float | None) -> None:
        """Set ``mean_weight`` of all pairs: see `fem_snh.terms.term.MeanForceTerm`."""
        for pair in self.pairs:
            pair.mean_weight = weight

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of all penalties; return whether a pair has one."""
        return any([pair.scale_penalties(factor) for pair in self.pairs])

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of contact and friction [J]. Collective."""
        x = self.configuration(u)
        return float(self._sum(sum(pair.energy(x) for pair in self.pairs)))

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add dE/du [N], minus the contact forces, to ``r_u`` by `add_nodal`. Collective."""
        x = self.configuration(u)
        for pair in self.pairs:
            self.add_nodal(pair.gradient(x), r_u)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add this rank's filtered Hessian; return how many points were filtered. Collective."""
        choose("filter", filter, FILTERS)
        x = self.configuration(u)
        return sum(pair.add_hessian(x, filter, target) for pair in self.pairs)

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return the pairs' rows for run.json: ``{key: {pair name: row}}``. Collective."""
        x = self.configuration(u)
        return {self.key: {pair.name: pair.row(x) for pair in self.pairs}}

    @property
    def goals(self) -> Sequence[str]:
        """Each pair's ``NAME.force``: the force on its first surface, or on the body."""
        return [f"{pair.name}.force" for pair in self.pairs]

    def goal(self, name: str, u: PETSc.Vec) -> Array:
        """Return the force of one of the `goals`, summed over all ranks, (3,) [N]. Collective."""
        pair, x = self.pairs[self.goals.index(name)], self.configuration(u)
        return np.asarray(self._sum(pair.nodal_forces(x).sum(axis=0)))

    def add_nodal_forces(self, name: str, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the nodal forces [N] of one of the `goals` to ``r`` by `add_nodal`. Collective."""
        pair, x = self.pairs[self.goals.index(name)], self.configuration(u)
        self.add_nodal(pair.nodal_forces(x), r)

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative of a force component by u, without friction, to ``g``. Collective."""
        pair, x = self.pairs[self.goals.index(name)], self.configuration(u)
        self.add_nodal(pair.force_derivative(component, x), g)

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset multipliers and friction to those of the last accepted step. Collective."""
        x = self.configuration(u)
        for pair in self.pairs:
            pair.begin_step(x)

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Update lagged quantities of all pairs; return the largest change. Collective."""
        x = self.configuration(u)
        return largest_change([change for pair in self.pairs for change in pair.settle(x)])

    def end_step(self, u: PETSc.Vec) -> None:
        """Store the lagged quantities, as the step is accepted. Collective."""
        x = self.configuration(u)
        for pair in self.pairs:
            pair.end_step(x)


class SelfContactTerm(SurfaceContact, CouplingTerm):
    r"""The base of both methods of self-contact: surface, sparsity pattern, contact pressure.

    The contact pressure at node a is the contact force :math:`f_a` per area. With the weights
    :math:`W` of the surface's points :math:`i` (`EmbeddedSurface`) and their areas :math:`A_i`
    (`point_areas`),

    .. math:: p_a = \frac{|f_a|}{\sum_i W_{ia} A_i} .

    The areas are deformed ones, for the nominal pressure reference ones. Nodes without an area
    have pressure 0.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    skin : Skin or None
        The surface, if a lattice carries it; None for the boundary of the mesh.
    kinematics : Kinematics, optional
        Kinematics of the displacement.

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
        """Return the positions of the surface's points, (n, components) [m]. Collective."""
        return self.surface.positions(self._nodal(u))

    def _nodal(self, u: PETSc.Vec) -> Array:
        """Return a view of this rank's displacements, ghosts included, (nodes, components)."""
        return local_values(u).reshape(-1, self._kinematics.components)

    def end_step(self, u: PETSc.Vec) -> None:
        """Do nothing, as nothing is kept: the next step searches again."""

    def history(self) -> tuple[Array, Array]:
        """Return arrays without rows: the next step depends on the displacement alone."""
        return np.empty((0, 3)), np.empty((0, 1))

    def set_history(self, values: Array) -> None:
        """Do nothing, as there is no history."""

    def nodal_field(self, name: str, u: PETSc.Vec) -> Array:
        """Return a contact pressure [Pa], (local nodes,), ghosts included. Collective.

        For any other ``name`` the result is ``[0.]``.
        """
        if name not in CONTACT_PRESSURES:
            return np.zeros(1)
        forces = _dolfinx.create_vector(self._V)
        nodal = self._rows(forces)
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
        """Return the nodes' areas for surface points at x, (local nodes,) [m^2]; 0 at ghosts."""
        points = point_areas(x, self.surface.triangles, self._kinematics.revolved)
        areas = np.zeros((sum(_dolfinx.num_nodes(self._V)), 1))
        self.surface.add_own(points[:, None], areas)
        return areas[:, 0]
