"""Fields of contact at the nodes, for output."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.ghosted_vectors import (
    add_ghosts,
    local_values,
    update_ghosts,
    writable_values,
)
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.contact.embedded_surface import (
    EmbeddedSurface,
    SurfaceMatrix,
    embedded_surface,
    point_areas,
)
from fem_snh.contact.obstacle_pair import ObstaclePair
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.mesh.gmsh_model import Skin
from fem_snh.records.output_fields import CONTACT_PRESSURES
from fem_snh.terms.history import HistoryTerm
from fem_snh.terms.term import CouplingTerm

Array = npt.NDArray[Any]


class ObstacleFields:
    """The fields of `fem_snh.records.output_fields.AT_OBSTACLES` at the nodes. Collective.

    ``gap`` is the signed distance of each node from the closest obstacle [m]. ``contact_pressure``
    is the contact force per deformed area [Pa], ``nominal_contact_pressure`` that per reference
    area: at a vertex the mean over its facets, weighted by the shape function of degree 1;
    elsewhere it is interpolated between the vertices of a cell.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    pairs : sequence of ObstaclePair
        The contact with each obstacle.
    kinematics : Kinematics, optional
        That of the displacement.
    """

    def __init__(
        self, V: Any, pairs: Sequence[ObstaclePair], kinematics: Kinematics = SOLID
    ) -> None:
        self._pairs, self._X = pairs, V.tabulate_dof_coordinates()
        self._kinematics = kinematics
        self._space = Q = _dolfinx.function_space(V.mesh, 1)
        self._surface = SurfaceQuadrature(Q, None, pairs[0].surface.degree, kinematics.revolved)
        nodes = _dolfinx.reference_nodes(_dolfinx.cell_name(V.mesh), _dolfinx.degree(V))
        self._table = _dolfinx.tabulate_values(Q, nodes)
        self._nodes, self._num_nodes = _dolfinx.node_dofs(V), sum(_dolfinx.num_nodes(V))

    def evaluate(self, name: str, u: PETSc.Vec) -> Array:
        """Return a field at the displacement's nodes, ghosts included, (nodes,)."""
        values = self._kinematics.padded(local_values(u))
        if name in CONTACT_PRESSURES:
            return self._pressure(values, nominal=name != "contact_pressure")
        x = self._X + values
        return np.asarray(np.min([pair.distance(x) for pair in self._pairs], axis=0))

    def _pressure(self, values: Array, nominal: bool) -> Array:
        """Return the contact pressure at nodal displacements (nodes, 3)."""
        weights = self._surface.weights
        force = np.zeros_like(weights)
        for pair in self._pairs:
            points = pair.points(values)
            force[points.which] += weights[points.which] * points.normal_forces[0]
        areas = weights if nominal else self._pairs[0].surface.deformed_weights(values)
        found, areas = self._sums(force), self._sums(areas)
        found = np.divide(found, areas, out=found, where=areas > 0)
        nodal = np.zeros(self._num_nodes)
        nodal[self._nodes] = found[_dolfinx.node_dofs(self._space)] @ self._table.T
        return nodal

    def _sums(self, weighted: Array) -> Array:
        """Return the sum of weighted point values times each shape function of degree 1."""
        sums = np.zeros((self._surface.num_nodes, 1))
        self._surface.add_vectors(weighted[..., None], slice(None), sums)
        vector = _dolfinx.create_vector(self._space)
        writable_values(vector)[:] = sums[:, 0]
        add_ghosts(vector)
        update_ghosts(vector)
        return np.array(local_values(vector))


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
