"""Fields of contact at the nodes, for output."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.unknowns import (
    local_values,
    update_ghosts,
    writable_values,
)
from fem_snh.contact.embedded_surface import (
    EmbeddedSurface,
    SurfaceMatrix,
    embedded_surface,
    point_areas,
)
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.records.output_fields import CONTACT_PRESSURES
from fem_snh.terms.history import HistoryTerm
from fem_snh.terms.term import CouplingTerm

Array = npt.NDArray[Any]


class SelfContactTerm(HistoryTerm, CouplingTerm, ABC):
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

    name, has_penalties, is_contact = "self_contact", True, True

    def __init__(self, V: Any, skin: Skin | None, kinematics: Kinematics = SOLID) -> None:
        self._kinematics = kinematics
        self.surface: EmbeddedSurface = embedded_surface(V, skin, kinematics.revolved)
        self._V, self._matrix = V, SurfaceMatrix(self.surface)

    @abstractmethod
    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to this rank's own entries of ``r_u``. Collective."""

    def nodal_field(self, name: str, u: PETSc.Vec) -> Array:
        """Return a contact pressure, 0 of another field: see `Term.nodal_field`. Collective."""
        if name not in CONTACT_PRESSURES:
            return np.zeros(1)
        forces = _dolfinx.create_vector(self._V)
        values = writable_values(forces)
        values[:] = 0
        self.add_residual(u, None, forces, None)
        components, x = self._kinematics.components, self.surface.points
        if name == "contact_pressure":
            x = x.copy()
            moved = self.surface.positions(local_values(u).reshape(-1, components))
            x[:, : moved.shape[1]] = moved
        nodal, areas = values.reshape(-1, components), self._areas(x)
        size = np.linalg.norm(nodal, axis=1)
        found = np.divide(size, areas, out=np.zeros_like(size), where=areas > 0)
        nodal[:] = found[:, None]
        update_ghosts(forces)
        return np.array(local_values(forces).reshape(-1, components)[:, 0])

    def _areas(self, x: Array) -> Array:
        """Return the areas of this rank's nodes, with the surface's points at x [m^2]."""
        surface = self.surface
        points = point_areas(x, surface.triangles, self._kinematics.revolved)
        weighted = surface.weights * points[:, None]
        areas = np.bincount(
            surface.columns.ravel(), weighted.ravel(), minlength=len(surface.support.nodes)
        )
        nodal = np.zeros((sum(_dolfinx.num_nodes(self._V)), 3))
        surface.support.add_own(np.repeat(areas[:, None], 3, axis=1), nodal)
        return nodal[:, 0]
