"""The fields of a run at the points of its surface, and the colours that show one of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt
import pyvista as pv
from scipy.sparse import csr_matrix

from fem_snh.errors import BadInput
from fem_snh.viewing.export.states import States
from fem_snh.viewing.render.fields import component_index, split_component

Array = npt.NDArray[Any]


class SurfaceFields:
    """The fields at the points of a surface, at each stored load.

    A field of the cells has at a point the mean over the cells around the point.

    Parameters
    ----------
    states : States
        The states.
    nodes : (n,) int array
        The points of the surface, as rows of the mesh's points.
    """

    def __init__(self, states: States, nodes: Array) -> None:
        self._states, self._nodes = states, nodes
        mesh = states.mesh
        offsets = pv.convert_array(mesh.GetCells().GetOffsetsArray())
        cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
        points = np.asarray(mesh.cell_connectivity)
        around = csr_matrix((np.ones(len(cells)), (points, cells)), (mesh.n_points, mesh.n_cells))
        self._around = around[nodes]
        self._count = np.asarray(self._around.sum(axis=1))

    def read(self, number: int) -> dict[str, Array]:
        """Return all fields of a state by name, (n,) or (n, components)."""
        state = self._states.read(number)
        found = {name: values[self._nodes] for name, values in state.point_data.items()}
        for name, values in state.cell_data.items():
            rows = self._around @ values.reshape(len(values), -1) / self._count
            found[name] = rows.reshape(-1, *values.shape[1:])
        return found

    def scalar(self, number: int, field: str) -> Array:
        """Return a scalar field, a component or the magnitude of a field, (n,).

        Raises
        ------
        BadInput
            If a value is not finite.
        """
        values: Array = self.read(number)[split_component(field)[0]]
        values = values.reshape(len(self._nodes), -1)
        component = component_index(field)
        if component is not None:
            values = values[:, [component]]
        found = values[:, 0] if values.shape[1] == 1 else np.linalg.norm(values, axis=1)
        if not np.all(np.isfinite(found)):
            raise BadInput(f"'{field}' at load {self._states.loads[number]:g} is not finite")
        return np.asarray(found, dtype=float)


def colours_of(fields: SurfaceFields, field: str, count: int) -> Callable[[Array], Array]:
    """Return the function from values (n,) to sRGB colours (n, 3), from 0 to 1, as in pictures.

    Parameters
    ----------
    fields : SurfaceFields
        The fields.
    field : str
        Name of a field or component.
    count : int
        The number of stored loads, which share one range.
    """
    from fem_snh.viewing.render.drawing import colour_function

    return colour_function(
        field, np.concatenate([fields.scalar(number, field) for number in range(count)])
    )


def linear_rgb(srgb: Array) -> Array:
    """Return linear colours of sRGB colours (IEC 61966-2-1), both from 0 to 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
