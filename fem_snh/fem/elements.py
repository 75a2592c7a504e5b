"""What "Q1", "P2P1", ... mean: the cell, the order of the displacement, the volume, the quadrature.

Three treatments of a material's volume term U(J):

pointwise   at every quadrature point, as it stands. Locks as nu -> 1/2 (least with order 2)
mean        U of the cell's mean J: one volume condition a cell instead of one a point
pressure    a continuous pressure is unknown, too (Taylor-Hood): nothing locks, nu = 1/2 included
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from fem_snh.errors import choose


@dataclass(frozen=True)
class Element:
    """A displacement element and its volume treatment.

    Attributes
    ----------
    name : as users write it.
    cell : "hexahedron" or "tetrahedron".
    degree : of the Lagrange displacement, 3 components a node.
    quadrature : polynomial degree that the rule integrates exactly on the reference cell.
    volume : "pointwise", "mean" or "pressure".
    pressure_degree : of the Lagrange pressure, if that is unknown.
    """

    name: str
    cell: str
    degree: int
    quadrature: int
    volume: str = "pointwise"
    pressure_degree: int = 0


#: What the degrees give and cost: docs/results/elements.md. Three on tetrahedra (6 points) is the
#: least that integrates J, which an incompressible cell's volume is made of.
ELEMENTS = {
    e.name: e
    for e in (
        Element("P1", "tetrahedron", 1, 1),  # 1 point: F is constant
        Element("P2", "tetrahedron", 2, 2),  # 4 points, the fewest without spurious modes
        Element("P2P0", "tetrahedron", 2, 3, "mean"),
        Element("P2P1", "tetrahedron", 2, 3, "pressure", 1),
        Element("Q1", "hexahedron", 1, 3),  # 2 x 2 x 2 points, the paper's
        Element("Q1P0", "hexahedron", 1, 3, "mean"),
        Element("Q2", "hexahedron", 2, 5),  # 3 x 3 x 3 points
        Element("Q2Q1", "hexahedron", 2, 5, "pressure", 1),
    )
}


def element(name: str, quadrature: int | None = None) -> Element:
    """The element called ``name``, perhaps with another quadrature degree.

    Raises BadInput for an unknown name.
    """
    found = ELEMENTS[choose("element", name, ELEMENTS)]
    return found if quadrature is None else replace(found, quadrature=quadrature)
