"""What "Q1", "P2", ... mean: the cell, the order of the displacement, the quadrature."""

from __future__ import annotations

from dataclasses import dataclass, replace

from fem_snh.errors import choose


@dataclass(frozen=True)
class Element:
    """A displacement element.

    Attributes
    ----------
    name : as users write it.
    cell : "hexahedron" or "tetrahedron".
    degree : of the Lagrange displacement, 3 components a node.
    quadrature : polynomial degree that the rule integrates exactly on the reference cell.
    """

    name: str
    cell: str
    degree: int
    quadrature: int


ELEMENTS = {
    e.name: e
    for e in (
        Element("P1", "tetrahedron", 1, 1),  # 1 point: F is constant
        Element("P2", "tetrahedron", 2, 2),  # 4 points, the fewest without spurious modes
        Element("Q1", "hexahedron", 1, 3),  # 2 x 2 x 2 points, the paper's
        Element("Q2", "hexahedron", 2, 5),  # 3 x 3 x 3 points
    )
}


def element(name: str, quadrature: int | None = None) -> Element:
    """The element called ``name``, perhaps with another quadrature degree.

    Raises BadInput for an unknown name.
    """
    found = ELEMENTS[choose("element", name, ELEMENTS)]
    return found if quadrature is None else replace(found, quadrature=quadrature)
