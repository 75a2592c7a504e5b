"""Which constrained nodes are on a facet that is constrained as a whole."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.ghosted_vectors import summed_over_ranks

Array = npt.NDArray[Any]

#: Distance of a node from a facet of the reference cell that is rounding.
_ROUNDING = 1e-9


def covered_nodes(V: Any, constrained: Array, axis: Array) -> Array:
    """Return the nodes of facets whose nodes are all constrained, by component. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    constrained : (local nodes, components) bool
        What is constrained, ghosts included.
    axis : (n,) int
        Local nodes on the axis of revolution, whose facets have no area.

    Returns
    -------
    (local nodes, components) bool
    """
    domain, cells = V.mesh, _dolfinx.node_dofs(V)
    kind = _dolfinx.cell_name(domain)
    off_axis = np.ones(len(constrained), dtype=bool)
    off_axis[axis] = False
    marks = np.zeros(constrained.shape)
    for local in _facets(kind, _dolfinx.reference_nodes(kind, _dolfinx.degree(V))):
        nodes = cells[:, local]
        whole = constrained[nodes].all(axis=1) & off_axis[nodes].any(axis=1)[:, None]
        for component in range(constrained.shape[1]):
            marks[nodes[whole[:, component]], component] = 1.0
    return summed_over_ranks(V, marks) > 0


def _facets(kind: str, points: Array) -> list[Array]:
    """Return the numbers of the nodes on each facet of a reference cell."""
    distances = list(points.T)
    if kind in ("triangle", "tetrahedron"):
        distances.append(1 - points.sum(axis=1))
    else:
        distances += list(1 - points.T)
    return [np.flatnonzero(np.abs(distance) < _ROUNDING) for distance in distances]
