"""The volume ratio and the strain at the quadrature points of a part of the body, by numpy.

The cell loops (`fem_snh.kernels`) return extremes and means over cells only; this is for the few
evaluations that need the points themselves.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.cell_loops import ElementTables

Array = npt.NDArray[np.float64]

#: Cells that are evaluated at a time, which bounds the memory.
_BATCH = 10_000


class PointVolumes(NamedTuple):
    """Volumes and strains at the quadrature points of cells.

    Attributes
    ----------
    weights : (cells, points)
        Quadrature weights [m^3], times the fraction that the body fills.
    growth : (cells, points)
        J - 1, without cancellation at small strain.
    strain, shear : float
        Integrals of the squared norms of the Green-Lagrange strain and of its deviator [m^3].
    """

    weights: Array
    growth: Array
    strain: float
    shear: float


def point_volumes(tables: ElementTables, u: Array) -> PointVolumes:
    """Return the volumes at the quadrature points of an element's cells.

    Parameters
    ----------
    tables : ElementTables
        The cells.
    u : (components * nodes,)
        Displacements [m] of this rank's nodes, ghosts included.
    """
    shape = len(tables.nodes), len(tables.weights)
    weights, growth = np.empty(shape), np.empty(shape)
    strain = shear = 0.0
    kinematics = tables.kinematics
    nodal = kinematics.padded(u)
    for start in range(0, shape[0], _BATCH):
        chunk = slice(start, start + _BATCH)
        x = tables.x[tables.geometry[chunk]]
        T = np.einsum("cai,qak->cqik", x, tables.geometry_gradients, optimize=True)
        kinematics.set_third_tangent(T)
        weights[chunk] = np.abs(np.linalg.det(T)) * tables.weights
        values = nodal[tables.nodes[chunk]]
        gradient = np.einsum("cai,qak->cqik", values, tables.gradients, optimize=True)
        H = gradient @ np.linalg.inv(T)
        kinematics.set_third_column(H)
        trace, HH = np.trace(H, axis1=2, axis2=3), np.einsum("cqij,cqji->cq", H, H)
        growth[chunk] = trace + (trace**2 - HH) / 2 + np.linalg.det(H)
        H_T = np.swapaxes(H, 2, 3)
        E = (H + H_T + H_T @ H) / 2
        squares, mean = (E**2).sum(axis=(2, 3)), np.trace(E, axis1=2, axis2=3) / 3
        if tables.fractions is not None:
            weights[chunk] *= tables.fractions[chunk, None]
        strain += float((weights[chunk] * squares).sum())
        shear += float((weights[chunk] * (squares - 3 * mean**2)).sum())
    return PointVolumes(weights, growth, strain, shear)


def cell_centres(tables: ElementTables, cells: Array) -> Array:
    """Return the mean of the geometry nodes [m] of some of the cells, (n, 3)."""
    return tables.x[tables.geometry[cells]].mean(axis=1)
