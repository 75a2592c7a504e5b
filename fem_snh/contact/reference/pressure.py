"""The pressure of self-contact at the nodes."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.ghosted_vectors import local_values, update_ghosts, writable_values
from fem_snh.contact.surfaces.embedded_surface import EmbeddedSurface

Array = npt.NDArray[Any]


class SelfContactPressure:
    r"""The force of self-contact per reference area of the surface, at the nodes. Collective.

    With the weights :math:`W` of the surface's points :math:`i` (`EmbeddedSurface`) and a third of
    their triangles' areas :math:`A_i`,

    .. math:: p_a = \frac{|f_a|}{\sum_i W_{ia} A_i},

    where :math:`f_a` is the nodal force of contact. At other nodes it is zero.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    term : ReferenceContact or IPC
        The contact.
    """

    def __init__(self, V: Any, term: Any) -> None:
        self._V, self._term = V, term
        surface: EmbeddedSurface = term.surface
        a, b, c = (surface.points[surface.triangles[:, i]] for i in range(3))
        thirds = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 6
        points = np.bincount(surface.triangles.ravel(), np.repeat(thirds, 3), len(surface.points))
        weighted = surface.weights * points[:, None]
        areas = np.bincount(
            surface.columns.ravel(), weighted.ravel(), minlength=len(surface.support.nodes)
        )
        self._areas = np.zeros((sum(_dolfinx.num_nodes(V)), 3))
        surface.support.add_own(np.repeat(areas[:, None], 3, axis=1), self._areas)

    def evaluate(self, u: PETSc.Vec) -> Array:
        """Return the pressure [Pa] at this rank's nodes, ghosts included, (nodes,). Collective."""
        forces = _dolfinx.create_vector(self._V)
        values = writable_values(forces)
        values[:] = 0
        self._term.add_residual(u, None, forces, None)
        nodal = values.reshape(-1, 3)
        size = np.linalg.norm(nodal, axis=1)
        area = self._areas[:, 0]
        nodal[:] = np.divide(size, area, out=np.zeros_like(size), where=area > 0)[:, None]
        update_ghosts(forces)
        return np.array(local_values(forces).reshape(-1, 3)[:, 0])
