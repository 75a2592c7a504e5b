"""Points of the reference body: the cell each is in, and its place in the reference cell."""

from __future__ import annotations

from typing import Any

import numpy as np

from fem_snh._dolfinx.meshes import _only, cell_name, geometry_dofs, geometry_x

Array = np.ndarray


def bounding_box(domain: Any) -> Array:
    """(2, 3): least and greatest coordinates of this rank's nodes; (inf, -inf) if it has none."""
    x = geometry_x(domain)[geometry_dofs(domain).ravel()]
    return np.stack([x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)])


def locate(domain: Any, point: Array) -> tuple[int, Array, float]:
    """This rank's cell that is nearest to having ``point`` (3,) in it.

    Returns the cell, the point in reference coordinates, and how far these are outside the
    reference cell: <= 0 inside; inf, with cell -1, if the point is near no cell of this rank. Not
    collective.
    """
    x = geometry_x(domain)[geometry_dofs(domain)]
    low, high = x.min(axis=1), x.max(axis=1)
    margin = 0.1 * (high - low).max(axis=1, initial=0)[:, None]  # curved cells bulge
    near = np.flatnonzero(((point > low - margin) & (point < high + margin)).all(axis=1))
    best = (-1, np.zeros(3), np.inf)
    for cell in near:
        try:
            place = _only(domain.geometry, "cmap").pull_back(point[None], x[cell])[0]
        except RuntimeError:  # Newton's method did not converge: outside a cell that is no box
            continue
        beyond = _beyond(cell_name(domain), place)
        if beyond < best[2]:
            best = (int(cell), place, beyond)
    return best


def _beyond(cell: str, place: Array) -> float:
    """How far a point (3,) is outside the reference cell: the greatest of its inequalities."""
    other = place.sum() if cell == "tetrahedron" else place.max()
    return float(max(-place.min(), other - 1))
