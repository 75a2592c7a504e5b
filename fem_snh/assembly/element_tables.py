"""The tables of an element that the compiled cell loops read, from dolfinx spaces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.cell_loops import ElementTables
from fem_snh.assembly.elements import Element
from fem_snh.assembly.kinematics import Kinematics

Array = npt.NDArray[Any]


def element_tables(
    V: Any, element: Element, Q: Any = None, pressure_scale: float = 1.0
) -> ElementTables:
    """Return basis, geometry and quadrature of ``element`` on this rank's cells of V.

    With a pressure space Q, its basis functions are multiplied by ``pressure_scale``.
    """
    domain, kinematics = V.mesh, element.kinematics
    points, weights = _dolfinx.quadrature(element.cell, element.quadrature)
    gradients, geometry = _dolfinx.tabulate(V, points), _dolfinx.tabulate_geometry(domain, points)
    if kinematics.dim == 2:
        N = _dolfinx.tabulate_values(V, points)
        gradients = _with_third(gradients, N, kinematics)
        N = _dolfinx.tabulate_geometry_values(domain, points)
        geometry = _with_third(geometry, N, kinematics)
    if kinematics.revolved:
        weights = 2 * np.pi * weights  # of the whole turn
    tables = ElementTables(
        _dolfinx.node_dofs(V),
        _dolfinx.geometry_dofs(domain),
        _dolfinx.geometry_x(domain),
        gradients,
        geometry,
        weights,
        element.volume,
        kinematics=kinematics,
    )
    if Q is None:
        return tables
    basis = pressure_scale * _dolfinx.tabulate_values(Q, points)
    return replace(tables, pressure_nodes=_dolfinx.node_dofs(Q), pressure_basis=basis)


def _with_third(gradients: Array, basis: Array, kinematics: Kinematics) -> Array:
    """Return gradients (points, nodes, 2) with the third entry that kinematics.h expects."""
    third = basis if kinematics.revolved else np.zeros_like(basis)
    return np.concatenate([gradients, third[:, :, None]], axis=2)


def restricted(
    tables: ElementTables, cells: Array, fractions: Array | None = None
) -> ElementTables:
    """Return an element's tables on some of the cells, (n,), with their fractions, (n,)."""
    chosen = selection(cells, len(tables.nodes))
    pressure = tables.pressure_nodes
    return replace(
        tables,
        nodes=tables.nodes[chosen],
        geometry=tables.geometry[chosen],
        fractions=fractions,
        pressure_nodes=pressure[chosen] if len(pressure) else pressure,
    )


def selection(cells: Array, num_cells: int) -> Any:
    """Return an index of these cells, without a copy if they are all of this rank's."""
    return slice(None) if len(cells) == num_cells else cells
