"""Fields of contact at the nodes, for output."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from functools import cached_property
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
from fem_snh.mesh.skin import Skin

Array = npt.NDArray[Any]


class ObstacleFields:
    """The fields of `fem_snh.output_fields.AT_OBSTACLES` at the nodes. Collective.

    ``gap`` is the signed distance of each node from the closest obstacle [m]. ``contact_pressure``
    is the contact force per reference area [Pa]: at a vertex the mean over its facets, weighted by
    the shape function of degree 1; elsewhere it is interpolated between the vertices of a cell.

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
        everywhere = np.ones((len(self._surface), len(self._surface.points)))
        self._areas = self._sums(np.arange(len(self._surface)), everywhere)

    def evaluate(self, name: str, u: PETSc.Vec) -> Array:
        """Return a field at the displacement's nodes, ghosts included, (nodes,)."""
        values = self._kinematics.padded(local_values(u))
        if name == "contact_pressure":
            return self._pressure(values)
        x = self._X + values
        return np.asarray(np.min([pair.distance(x) for pair in self._pairs], axis=0))

    def _pressure(self, values: Array) -> Array:
        """Return the contact pressure at nodal displacements (nodes, 3)."""
        found = np.zeros_like(self._areas)
        for pair in self._pairs:
            points = pair.points(values)
            found += self._sums(points.which, points.normal_forces[0])
        found = np.divide(found, self._areas, out=found, where=self._areas > 0)
        nodal = np.zeros(self._num_nodes)
        nodal[self._nodes] = found[_dolfinx.node_dofs(self._space)] @ self._table.T
        return nodal

    def _sums(self, which: Array, values: Array) -> Array:
        """Return the integral of point values times each shape function of degree 1. Collective."""
        sums = np.zeros((self._surface.num_nodes, 3))
        weighted = self._surface.weights[which] * values
        self._surface.add_vectors(weighted[..., None] * [1.0, 0.0, 0.0], which, sums)
        vector = _dolfinx.create_vector(self._space)
        writable_values(vector)[:] = sums[:, 0]
        add_ghosts(vector)
        update_ghosts(vector)
        return np.array(local_values(vector))


class SelfContactTerm(ABC):
    r"""What both methods of self-contact share: the surface, its matrix, the contact pressure.

    The pressure is the force per reference area at the nodes. With the weights :math:`W` of the
    surface's points :math:`i` (`EmbeddedSurface`) and their areas
    :math:`A_i` (`point_areas`),

    .. math:: p_a = \frac{|f_a|}{\sum_i W_{ia} A_i},

    where :math:`f_a` is the nodal force of contact. At other nodes it is zero.

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

    name, has_energy, depends_on_load = "self_contact", True, False

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
        """Return the contact pressure, 0 of another field: see `FieldTerm`. Collective."""
        if name != "contact_pressure":
            return np.zeros(1)
        forces = _dolfinx.create_vector(self._V)
        values = writable_values(forces)
        values[:] = 0
        self.add_residual(u, None, forces, None)
        components = self._kinematics.components
        nodal = values.reshape(-1, components)
        size = np.linalg.norm(nodal, axis=1)
        nodal[:] = np.divide(size, self._areas, out=np.zeros_like(size), where=self._areas > 0)[
            :, None
        ]
        update_ghosts(forces)
        return np.array(local_values(forces).reshape(-1, components)[:, 0])

    @cached_property
    def _areas(self) -> Array:
        """The areas of this rank's nodes, ghosts included, (nodes,) [m^2]."""
        surface = self.surface
        points = point_areas(surface.points, surface.triangles, self._kinematics.revolved)
        weighted = surface.weights * points[:, None]
        areas = np.bincount(
            surface.columns.ravel(), weighted.ravel(), minlength=len(surface.support.nodes)
        )
        nodal = np.zeros((sum(_dolfinx.num_nodes(self._V)), 3))
        surface.support.add_own(np.repeat(areas[:, None], 3, axis=1), nodal)
        return nodal[:, 0]
