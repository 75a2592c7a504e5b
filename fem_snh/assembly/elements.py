"""Elements by name: cell, displacement degree, quadrature, treatment of the volume term.

An element treats a material's volume term U(J) in one of four ways:

``pointwise``
    U(J) at every quadrature point. Locks as Poisson's ratio approaches 1/2, least with degree 2.
``mean``
    U of the mean J of each cell: one volume constraint per cell instead of one per point.
``cell_pressure``
    As ``mean``, with the pressure of each cell as an unknown: `with_cell_pressures`.
``pressure``
    A continuous pressure is an unknown (Taylor-Hood). Does not lock, nu = 1/2 included.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from fem_snh.assembly.kinematics import PLANE_CELLS, SOLID, Kinematics
from fem_snh.errors import bad_value, check_whole, choose

#: Highest quadrature degree: that of the last Xiao-Gimbutas rule on tetrahedra in basix.
MAX_QUADRATURE_DEGREE = 30


@dataclass(frozen=True)
class Element:
    """A displacement element and its treatment of the volume term.

    Attributes
    ----------
    name : str
        Name in scenes and on the command line.
    cell : {"hexahedron", "tetrahedron", "quadrilateral", "triangle"}
        Kind of cell.
    degree : int
        Degree of the Lagrange displacement.
    quadrature : int
        Degree of polynomials that the quadrature rule integrates exactly on the reference cell.
    least : int
        The lowest quadrature degree with which the only zero eigenvalues of one cell's stiffness
        are those of the rigid motions.
    volume : {"pointwise", "mean", "cell_pressure", "pressure"}
        Treatment of the volume term.
    pressure_degree : int
        Degree of the Lagrange pressure; 0 if there is none or one in each cell.
    kinematics : Kinematics
        How the displacement becomes a deformation gradient.
    """

    name: str
    cell: str
    degree: int
    quadrature: int
    least: int
    volume: str = "pointwise"
    pressure_degree: int = 0
    kinematics: Kinematics = SOLID

    @property
    def has_pressure(self) -> bool:
        """Whether the pressure is an unknown."""
        return self.volume in ("cell_pressure", "pressure")


#: The elements with their default quadrature; docs/results/elements.md measures other degrees. On
#: tetrahedra degree 3 (6 points) is the lowest that integrates J, a cell's volume, exactly. The
#: least degrees follow from the eigenvalues of one cell (tests/assembly/test_element_modes.py).
ELEMENTS = {
    e.name: e
    for e in (
        Element("P1", "tetrahedron", 1, 1, 1),  # 1 point: F is constant
        Element("P2", "tetrahedron", 2, 2, 2),  # 4 points
        Element("P2P0", "tetrahedron", 2, 3, 2, "mean"),
        Element("P2P1", "tetrahedron", 2, 3, 2, "pressure", 1),
        Element("Q1", "hexahedron", 1, 3, 2),  # 2 x 2 x 2 points, as in Smith et al. 2018
        Element("Q1P0", "hexahedron", 1, 3, 2, "mean"),
        Element("Q2", "hexahedron", 2, 5, 4),  # 3 x 3 x 3 points
        Element("Q2Q1", "hexahedron", 2, 5, 4, "pressure", 1),
    )
}


#: The lowest quadrature degree on bodies of revolution: with one quadrature point, a rotation of
#: the cell in the half plane about this point has no strain there.
_LEAST_REVOLVED = 2


#: The plural of each kind of cell, for messages.
CELLS = {
    "tetrahedron": "tetrahedra",
    "hexahedron": "hexahedra",
    "triangle": "triangles",
    "quadrilateral": "quadrilaterals",
}


def names_for(cell: str) -> list[str]:
    """Return the names of the elements on a kind of cell, e.g. "triangle"."""
    return [e.name for e in ELEMENTS.values() if cell in (e.cell, PLANE_CELLS[e.cell])]


def element(name: str, quadrature: int | None = None, kinematics: Kinematics = SOLID) -> Element:
    """Return the element with this name, with another quadrature degree if one is given.

    Parameters
    ----------
    name : str
        One of ELEMENTS.
    quadrature : int, optional
        Quadrature degree, from the element's least to MAX_QUADRATURE_DEGREE. Default: the
        element's own.
    kinematics : Kinematics, optional
        With two-dimensional kinematics the element is on triangles or quadrilaterals.

    Raises
    ------
    BadInput
        For an unknown name, a degree out of range, or a volume treatment other than "pointwise" in
        plane stress.
    """
    found = ELEMENTS[choose("element", name, ELEMENTS)]
    if kinematics.dim == 2:
        if kinematics.plane_stress and found.volume != "pointwise":
            names = ", ".join(e.name for e in ELEMENTS.values() if e.volume == "pointwise")
            accepted = f"one of {names}, in plane stress: a sheet that thins does not lock"
            raise bad_value("element", name, accepted)
        found = in_kinematics(found, kinematics)
    if quadrature is None:
        return found
    check_whole("quadrature", quadrature, 1, MAX_QUADRATURE_DEGREE)
    if quadrature < found.least:
        accepted = f"a whole number from {found.least} to {MAX_QUADRATURE_DEGREE} with {name}: "
        raise bad_value("quadrature", quadrature, accepted + "a lower degree leaves spurious modes")
    return replace(found, quadrature=quadrature)


def in_kinematics(element: Element, kinematics: Kinematics) -> Element:
    """Return a three-dimensional element, converted to the cells of given kinematics.

    On bodies of revolution the quadrature degree is at least ``_LEAST_REVOLVED``.
    """
    if kinematics.dim == 3:
        return element
    cell = PLANE_CELLS[element.cell]
    least = max(element.least, _LEAST_REVOLVED) if kinematics.revolved else element.least
    default = max(element.quadrature, least)
    return replace(element, cell=cell, quadrature=default, least=least, kinematics=kinematics)


def with_cell_pressures(element: Element) -> Element:
    """Return a mean-dilatation element with the pressure of each cell as an unknown.

    Both elements have the same equilibria: eliminating the pressures (static condensation) gives U
    of the mean J.
    """
    return replace(element, volume="cell_pressure")
