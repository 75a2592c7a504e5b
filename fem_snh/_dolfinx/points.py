"""Locate points of the reference body: cell and coordinates in the reference cell."""

from __future__ import annotations

from typing import Any

import numpy as np

from fem_snh._dolfinx.meshes import _only, cell_name, geometry_dofs, geometry_x

Array = np.ndarray

#: A cell is searched if the point is in the bounding box of its nodes, enlarged by this fraction:
#: curved cells extend beyond their nodes.
_MARGIN = 0.1


def bounding_box(domain: Any) -> Array:
    """Return the smallest and largest coordinates of this rank's nodes, (2, 3).

    Without nodes they are inf and -inf.
    """
    x = geometry_x(domain)[geometry_dofs(domain).ravel()]
    return np.stack([x.min(axis=0, initial=np.inf), x.max(axis=0, initial=-np.inf)])


def locate(domain: Any, point: Array) -> tuple[int, Array, float]:
    """Return this rank's cell that contains ``point`` (3,), or comes closest to it. Not collective.

    Returns
    -------
    cell : int
        Local number of the cell; -1 if the point is near no cell of this rank.
    xi : (dim,) array
        The point's coordinates in the reference cell.
    outside : float
        Distance of ``xi`` from the reference cell: <= 0 inside, inf without a cell.
    """
    x = geometry_x(domain)[geometry_dofs(domain)]
    low, high = x.min(axis=1), x.max(axis=1)
    margin = _MARGIN * (high - low).max(axis=1, initial=0)[:, None]
    near = np.flatnonzero(((point > low - margin) & (point < high + margin)).all(axis=1))
    dim = domain.geometry.dim
    best = (-1, np.zeros(dim), np.inf)
    for cell in near:
        try:
            xi = _only(domain.geometry, "cmap").pull_back(point[None, :dim], x[cell][:, :dim])[0]
        except RuntimeError:  # Newton's method diverged, so the point is outside the cell
            continue
        outside = _distance_outside(cell_name(domain), xi)
        if outside < best[2]:
            best = (int(cell), xi, outside)
    return best


def _distance_outside(cell: str, xi: Array) -> float:
    """Return the largest violation of the inequalities that define the reference cell."""
    upper = xi.sum() if cell in ("tetrahedron", "triangle") else xi.max()
    return float(max(-xi.min(), upper - 1))
