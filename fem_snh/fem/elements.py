"""Elements by name: cell, displacement degree, quadrature, treatment of the volume term.

An element treats a material's volume term U(J) in one of four ways:

``pointwise``
    U(J) at every quadrature point. Locks as Poisson's ratio approaches 1/2, least with degree 2.
``mean``
    U of the mean J of each cell: one volume constraint per cell instead of one per point.
``cell_pressure``
    The same with the pressure of each cell as an unknown: `with_cell_pressures`.
``pressure``
    A continuous pressure is an unknown (Taylor-Hood). Does not lock, nu = 1/2 included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from fem_snh.errors import bad_value, choose

#: Highest quadrature degree: that of the last Xiao-Gimbutas rule on tetrahedra in basix.
MAX_QUADRATURE_DEGREE = 30


@dataclass(frozen=True)
class Element:
    """A displacement element and its treatment of the volume term.

    Attributes
    ----------
    name : str
        Name in scenes and on the command line.
    cell : {"hexahedron", "tetrahedron"}
        Kind of cell.
    degree : int
        Degree of the Lagrange displacement, 3 components per node.
    quadrature : int
        Degree of polynomials that the quadrature rule integrates exactly on the reference cell.
    volume : {"pointwise", "mean", "cell_pressure", "pressure"}
        Treatment of the volume term.
    pressure_degree : int
        Degree of the Lagrange pressure; 0 if there is none or one in each cell.
    """

    name: str
    cell: str
    degree: int
    quadrature: int
    volume: str = "pointwise"
    pressure_degree: int = 0

    @property
    def has_pressure(self) -> bool:
        """Whether the pressure is an unknown."""
        return self.volume in ("cell_pressure", "pressure")


#: The elements with their default quadrature; docs/results/elements.md measures other degrees. On
#: tetrahedra degree 3 (6 points) is the lowest that integrates J, a cell's volume, exactly.
ELEMENTS = {
    e.name: e
    for e in (
        Element("P1", "tetrahedron", 1, 1),  # 1 point: F is constant
        Element("P2", "tetrahedron", 2, 2),  # 4 points, the fewest without spurious modes
        Element("P2P0", "tetrahedron", 2, 3, "mean"),
        Element("P2P1", "tetrahedron", 2, 3, "pressure", 1),
        Element("Q1", "hexahedron", 1, 3),  # 2 x 2 x 2 points, as in Smith et al. 2018
        Element("Q1P0", "hexahedron", 1, 3, "mean"),
        Element("Q2", "hexahedron", 2, 5),  # 3 x 3 x 3 points
        Element("Q2Q1", "hexahedron", 2, 5, "pressure", 1),
    )
}


def element(name: str, quadrature: int | None = None) -> Element:
    """Return the element with this name, with another quadrature degree if one is given.

    Parameters
    ----------
    name : str
        One of ELEMENTS.
    quadrature : int, optional
        Quadrature degree, 1 to MAX_QUADRATURE_DEGREE. Default: the element's own.

    Raises
    ------
    BadInput
        For an unknown name or a degree out of range.
    """
    found = ELEMENTS[choose("element", name, ELEMENTS)]
    if quadrature is None:
        return found
    check_quadrature(quadrature)
    return replace(found, quadrature=quadrature)


def with_cell_pressures(element: Element) -> Element:
    """Return an element of mean dilatation with the pressure of each cell as an unknown.

    Both have the same equilibria: eliminating the pressures (static condensation) gives U of the
    mean J.
    """
    return replace(element, volume="cell_pressure")


def check_quadrature(degree: int) -> None:
    """Raise BadInput for a quadrature degree out of range."""
    if not 1 <= degree <= MAX_QUADRATURE_DEGREE:
        accepted = f"a whole number from 1 to {MAX_QUADRATURE_DEGREE}"
        raise bad_value("quadrature", degree, accepted)
