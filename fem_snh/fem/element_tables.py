"""The tables of an element that the compiled cell loops read, from dolfinx spaces."""

from __future__ import annotations

from typing import Any

from fem_snh import _dolfinx
from fem_snh.fem.elements import Element
from fem_snh.kernels.cell_loops import ElementTables


def element_tables(
    V: Any, element: Element, Q: Any = None, pressure_scale: float = 1.0
) -> ElementTables:
    """Return basis, geometry and quadrature of ``element`` on this rank's cells of V.

    With a pressure space Q, its basis functions are multiplied by ``pressure_scale``.
    """
    domain = V.mesh
    points, weights = _dolfinx.quadrature(element.cell, element.quadrature)
    tables = (
        _dolfinx.node_dofs(V),
        _dolfinx.geometry_dofs(domain),
        _dolfinx.geometry_x(domain),
        _dolfinx.tabulate(V, points),
        _dolfinx.tabulate_geometry(domain, points),
        weights,
        element.volume,
    )
    if Q is None:
        return ElementTables(*tables)
    basis = pressure_scale * _dolfinx.tabulate_values(Q, points)
    return ElementTables(*tables, _dolfinx.node_dofs(Q), basis)
