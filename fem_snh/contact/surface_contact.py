"""The energy of contact between surfaces: what obstacles, bodies and self-contact share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.kinematics import Kinematics
from fem_snh.assembly.unknowns import local_values, writable_values
from fem_snh.contact.law import ContactLaw
from fem_snh.terms.history import HistoryTerm
from fem_snh.terms.settling import LaggedChange, largest_change
from fem_snh.terms.term import ForceTerm

if TYPE_CHECKING:
    from fem_snh.contact.obstacle_pair import ObstaclePair
    from fem_snh.contact.surface_pair import SurfacePair

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
        see `fem_snh.terms.history.MeanForceTerm`.
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

    def __init__(self, V: Any, kinematics: Kinematics) -> None:
        self.comm, self._V, self._kinematics = V.mesh.comm, V, kinematics

    def configuration(self, u: PETSc.Vec) -> Array:
        """Return what the pairs get of the displacement: (nodes, 3). Collective."""
        return self._kinematics.padded(local_values(u))

    def add_nodal(self, values: Array, vector: PETSc.Vec) -> None:
        """Add vectors at the nodes of the configuration (nodes, c) to a vector. Collective."""
        out = self._rows(vector)
        out += values[:, : out.shape[1]]

    def _sum(self, values: Any) -> Any:
        """Return the sum of what the ranks have of the pairs."""
        return self.comm.allreduce(values, op=MPI.SUM)

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
    def goals(self) -> list[str]:
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
