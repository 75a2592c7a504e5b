"""What theory says of every element, and problems of every element, for their tests."""

from __future__ import annotations

from dataclasses import dataclass, replace

import pytest
from bodies import create_problem

from fem_snh.assembly.elements import ELEMENTS
from fem_snh.kernels.material import material


@dataclass(frozen=True)
class Theory:
    """What is known of an element.

    orders : of the displacement's error in L2 and in H1 where the solution is smooth, and of the
        pressure's in L2 where there is one.
    cells : two numbers of cells along an edge, fine enough to see these orders.
    least : the lowest quadrature degree that leaves no spurious modes.
    volume : the lowest that integrates J exactly, and so the volume of a deformed cell.
    locks : whether errors at a given mesh grow as nu -> 1/2.
    """

    orders: tuple[float, ...]
    cells: tuple[int, int]
    least: int
    volume: int
    locks: bool = False


#: J is of degree 3 (k - 1) on a tetrahedron of order k, of 3 k - 1 along an edge of a hexahedron.
#: Tensor rules of Gauss are exact for odd degrees: 2 is as good as 3.
THEORY = {
    "P1": Theory((2, 1), (8, 12), least=1, volume=1, locks=True),
    "Q1": Theory((2, 1), (8, 12), least=2, volume=2, locks=True),
    "P2": Theory((3, 2), (5, 7), least=2, volume=3, locks=True),
    "Q2": Theory((3, 2), (4, 6), least=4, volume=4, locks=True),
    "Q1P0": Theory((2, 1), (8, 12), least=2, volume=2),
    "P2P0": Theory((2, 1), (5, 7), least=2, volume=3),
    "P2P1": Theory((3, 2, 2), (5, 7), least=2, volume=3),
    "Q2Q1": Theory((3, 2, 2), (5, 8), least=4, volume=4),
}


def problem(body, element, nu, quadrature=None, E=1.0, **conditions):
    """Of the energy of eq. 13, whatever nu."""
    chosen = material("stable_neo_hookean", E=E, nu=nu, barrier=False)
    kind = ELEMENTS[element]
    if quadrature is not None:  # also one that a scene may not have
        kind = replace(kind, quadrature=quadrature)
    return create_problem(body, kind, chosen, **conditions)


def poissons(*values):
    """``element`` with each nu, and with 0.5 where a pressure is unknown."""
    pairs = [(element, nu) for element in ELEMENTS for nu in values]
    pairs += [(e.name, 0.5) for e in ELEMENTS.values() if e.volume == "pressure"]
    return pytest.mark.parametrize("element, nu", pairs)
