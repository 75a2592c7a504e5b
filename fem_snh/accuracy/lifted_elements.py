"""The elements in which problems are solved again to estimate errors, and what they cost.

The lifted element has a continuous pressure (Taylor-Hood), so that it does not lock either: Q1 and
Q1P0 are lifted to Q2Q1, P1 to P2P1, elements of degree 2 to P3P2 and Q3Q2. Others serve where that
is not needed, or not possible (docs/theory/error.md).
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from fem_snh import _dolfinx
from fem_snh.accuracy.no_estimate import TooLittleMemory
from fem_snh.accuracy.pressure_oscillation import may_lock
from fem_snh.assembly.elements import ELEMENTS, Element, in_kinematics
from fem_snh.problem.problem import Problem

#: Taylor-Hood elements of degree 3, on which nothing but the estimate relies. Their quadrature is
#: exact for products of two gradients on affine cells.
_DEGREE_3 = (
    Element("P3P2", "tetrahedron", 3, 5, 4, "pressure", 2),
    Element("Q3Q2", "hexahedron", 3, 7, 6, "pressure", 2),
)
_DEGREE_2 = (ELEMENTS["P2P1"], ELEMENTS["Q2Q1"])
_POINTWISE = (ELEMENTS["P2"], ELEMENTS["Q2"])
#: lambda/mu up to which an element with a pointwise volume term does not lock: nu = 0.4, rounded.
_NO_LOCKING = 4.0 * (1 + 1e-9)
#: The same for P2 and P3 on triangles, nu = 0.499: beyond, Newton's method may find no state of P3.
_LITTLE_LOCKING = 500.0
#: lambda/mu up to which the lifted element has no unknown pressure either, nu = 1/3: the estimate
#: takes a quarter to two thirds of the time, and misses 0.01 to 0.1 more of the error
#: (docs/results/error.md).
_COMPRESSIBLE = 2.0 * (1 + 1e-9)
#: Mean number of nodes to which a node is connected in a large mesh of boxes, each of six
#: tetrahedra, or of rectangles of two triangles; and what a pair of nodes needs in bytes: each
#: number of its block (9 in three dimensions) in double precision for the matrix and in single
#: precision for the linear solver, and indices; and as much again for the couplings of the
#: pressure, their copies and temporary arrays (a run of twist, 16 cells, Q1P0).
_COUPLED_NODES = {("tetrahedron", 2): 28, ("tetrahedron", 3): 50, ("hexahedron", 2): 64,
                  ("hexahedron", 3): 125, ("triangle", 2): 12, ("triangle", 3): 17,
                  ("quadrilateral", 2): 16, ("quadrilateral", 3): 25}  # fmt: skip
_BYTES_PER_NUMBER, _BYTES_PER_BLOCK, _COPIES = 8 + 4, 8, 2


def lifted_elements(problem: Problem) -> Iterator[Element]:
    """Return the elements to which a problem is lifted, the best first.

    The further ones are for materials whose volume term has no unknown pressure, such as that in
    log(J): the mean dilatation of each cell where they are nearly incompressible.
    """
    base = problem.element
    best = _on_cells_of(problem, _DEGREE_2 if base.degree == 1 else _DEGREE_3)
    pointwise = replace(best, name=best.name[:2], volume="pointwise", pressure_degree=0)
    constant = replace(best, name=f"{best.name[:2]}P0", volume="mean", pressure_degree=0)
    several = len(problem.elastic.parts) > 1
    alike = base.volume == "pointwise" or base.degree == 1  # P2P0 is another element at a corner
    compressible = alike and not nearly_incompressible(problem, _COMPRESSIBLE)
    # Energies in UFL alone, or a rigid body, have no pressure; a sheet that thins does not lock.
    if not problem.elastic.parts or problem.kinematics.plane_stress or compressible:
        yield pointwise
        return
    if problem.operator != problem.A and base.volume != "pressure":  # condensed as the run is
        yield constant
    elif several and base.volume != "pressure":  # a continuous pressure is wrong at interfaces
        # P2 on triangles hardly locks, and P3 less: one pressure in each cell is a coarser element.
        triangles = base.name == "P2" and base.kinematics.dim == 2
        if not nearly_incompressible(problem, _LITTLE_LOCKING if triangles else _NO_LOCKING):
            yield pointwise
        yield replace(constant, volume="cell_pressure")
    else:
        yield best
    if nearly_incompressible(problem):
        yield constant
    else:
        yield pointwise


def _on_cells_of(problem: Problem, elements: Sequence[Element]) -> Element:
    """Return the one of some elements of three dimensions that has the problem's kind of cell."""
    in_same = [in_kinematics(element, problem.kinematics) for element in elements]
    return next(element for element in in_same if element.cell == problem.element.cell)


def nearly_incompressible(problem: Problem, limit: float = _NO_LOCKING) -> bool:
    """Return whether a pointwise volume term can lock with one of the materials.

    It can from a ``limit`` of lambda over mu on.
    """
    moduli = [part.region.material.lame for part in problem.elastic.parts]
    return any(not lam <= limit * mu for mu, lam in moduli)


def element_of_factor(problem: Problem, lifted: Element) -> Element | None:
    """Return the element of the problem's degree whose error `saturation` continues.

    It treats the volume as the lifted one does: a Taylor-Hood element, or one with the volume term
    at every point. None if the problem's own element does, or is as good: an element that locks has
    a larger error, and one pressure in each cell may have a smaller one. Elements of degree 1 have
    no factor, nor have lifted ones with one pressure in each cell.
    """
    base = problem.element
    if base.degree < 2:
        return None
    if lifted.volume == "pressure" and base.volume != "pressure":
        same = base.volume == "pointwise" and not may_lock(problem)
        return None if same else _on_cells_of(problem, _DEGREE_2)
    if lifted.volume == "pointwise" and base.volume == "mean":
        return _on_cells_of(problem, _POINTWISE)
    return None


def lifted_dofs(problem: Problem, element: Element) -> int:
    """Return the number of unknowns of the lifted problem. Collective."""
    count = partial(_dolfinx.num_nodes_of_degree, problem.domain)
    pressures = count(element.pressure_degree) if element.has_pressure else 0
    return element.kinematics.components * count(element.degree) + pressures


def memory(problem: Problem, element: Element) -> float:
    """Return about how many bytes the lifted problem needs on all ranks. Collective."""
    components = element.kinematics.components
    pairs = lifted_dofs(problem, element) / components
    pairs *= _COUPLED_NODES[element.cell, element.degree]
    return float(pairs * _COPIES * (components**2 * _BYTES_PER_NUMBER + _BYTES_PER_BLOCK))


def check_memory(problem: Problem, element: str, needed: float, most: float) -> None:
    """Raise TooLittleMemory if an element needs more than ``most`` or is available [bytes].

    Collective.
    """
    available = available_memory(problem.comm)
    if needed > min(available, most):
        limit = f"{most / 1e6:.3g} MB are allowed"
        if available < most:
            limit = f"{available / 1e6:.2g} MB are available"
        raise TooLittleMemory(
            f"{element} needs about {needed / 1e6:.2g} MB of memory, of which {limit}"
        )


def available_memory(comm: Any) -> float:
    """Return the memory that is available to the ranks on all machines [bytes]. Collective."""
    return float(sum(dict(comm.allgather((os.uname().nodename, _available_here()))).values()))


def _available_here() -> float:
    """Return the memory that is available on this machine [bytes]; infinity if it is unknown."""
    try:
        with open("/proc/meminfo", encoding="ascii") as lines:
            rows = dict(line.split(":") for line in lines)
        return float(rows["MemAvailable"].split()[0]) * 1024
    except (OSError, KeyError, ValueError):
        return float("inf")
