"""The lifted problem: the same one in the element of the next degree on the same cells.

A body's error of discretisation is estimated as the difference between two equilibria: the run's,
and that of an element whose own error is smaller by a power of the cell size
(docs/theory/error.md).

The lifted element has a continuous pressure (Taylor-Hood), so that it does not lock either: Q1 and
Q1P0 are lifted to Q2Q1, P1 to P2P1, elements of degree 2 to P3P2 and Q3Q2. Others serve where that
is not needed, or not possible.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import psutil

from fem_snh import _dolfinx
from fem_snh.accuracy.goal_errors import NoEstimateOnAnyMesh
from fem_snh.assembly.elements import ELEMENTS, Element, in_kinematics
from fem_snh.assembly.unknowns import summed_over_cells
from fem_snh.errors import BadInput
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import LOCKING_RATIO, may_lock

T = TypeVar("T")

#: Taylor-Hood elements by their degree. Those of degree 3, on which nothing but the estimate
#: relies, have a quadrature that is exact for products of two gradients on affine cells.
_TAYLOR_HOOD = {
    2: (ELEMENTS["P2P1"], ELEMENTS["Q2Q1"]),
    3: (
        Element("P3P2", "tetrahedron", 3, 5, 4, "pressure", 2),
        Element("Q3Q2", "hexahedron", 3, 7, 6, "pressure", 2),
    ),
}
#: lambda/mu, which is rounded, up to which the lifted element has no pressure, nu = 1/3: the
#: estimate takes a quarter to two thirds of the time, and misses 0.01 to 0.1 more of the error
#: (docs/results/error.md).
_ROUNDED = 1 + 1e-9
_COMPRESSIBLE = 2.0 * _ROUNDED
#: lambda/mu up to which P2 on triangles and P3 hardly lock, nu = 0.499: beyond, Newton's method may
#: find no state of P3.
_LITTLE_LOCKING = 500.0
#: The run's pressure is no first guess if its residual is so many times that of zero pressure. For
#: locked elements the ratio is up to 2 (Cook's membrane, degree 1, nu = 0.4999); with a limit of 1
#: they need an iteration more, and without one `P1` on 2 cells of twist finds no equilibrium.
_WORSE = 4.0
#: Memory for each number in the matrices of all cells, by the dimension. In three: 19 to 26 bytes
#: in bodies of 23,000 to 216,000 unknowns (the peak of `fem-snh run twist` with --error less the
#: peak without). In two, with sparse factors: 27 to 30 bytes, and 55 to 73 with an unknown pressure
#: (the same of cook and stretch, 75,000 to 363,000 unknowns).
_BYTES = {2: 60, 3: 20}


def lifted_elements(problem: Problem) -> Iterator[Element]:
    """Return the elements to which a problem is lifted, the best first.

    The last one is for materials whose volume term has no unknown pressure, such as that in log(J):
    the mean dilatation of each cell where they are nearly incompressible.
    """
    base, parts = problem.element, problem.elastic.parts
    best = _taylor_hood(problem, min(base.degree, 2) + 1)
    pointwise, mean = (_with_volume(best, volume) for volume in ("pointwise", "mean"))
    ratio = max((lam / mu for mu, lam in (p.region.material.lame for p in parts)), default=0.0)
    alike = base.volume == "pointwise" or base.degree == 1  # P2P0 is another element at a corner
    # Energies in UFL alone, or a rigid body, have no pressure; a sheet that thins does not lock.
    if not parts or problem.kinematics.plane_stress or (alike and ratio <= _COMPRESSIBLE):
        yield pointwise
        return
    limit = _LITTLE_LOCKING if _is_quadratic_triangle(problem) else LOCKING_RATIO * _ROUNDED
    if base.volume != "pressure" and not problem.is_assembled:  # condensed as the run is
        yield mean
    elif base.volume == "pressure" or len(parts) == 1:
        yield best
    elif ratio > limit:  # a continuous pressure is wrong at interfaces of materials
        yield _with_volume(best, "cell_pressure")
    yield pointwise if ratio <= limit else mean


def element_of_factor(problem: Problem, lifted: Element) -> Element | None:
    """Return the element of the problem's degree whose error `saturation` continues; None: none.

    It treats the volume as the lifted one does: a Taylor-Hood element, or one with the volume term
    at every point. The problem's own element does, or is as good, unless it locks, which no decay
    of degrees shows; one pressure in each cell may have a smaller error, and elements of degree 1
    have no factor.
    """
    base = problem.element
    locks = bool(may_lock(problem)) and lifted.volume != base.volume
    if base.degree < 2:
        return None
    if lifted.volume == "pressure" != base.volume and (locks or base.volume != "pointwise"):
        return _taylor_hood(problem, 2)
    if lifted.volume == "pointwise" and base.volume == "mean":
        return _with_volume(_taylor_hood(problem, 2), "pointwise")
    return None if locks and not _is_quadratic_triangle(problem) else base


def _is_quadratic_triangle(problem: Problem) -> bool:
    """Return whether a problem has P2 on triangles, which hardly locks."""
    return problem.element.name == "P2" and problem.kinematics.dim == 2


def _taylor_hood(problem: Problem, degree: int) -> Element:
    """Return the Taylor-Hood element of a degree on the problem's cells."""
    in_same = [in_kinematics(element, problem.kinematics) for element in _TAYLOR_HOOD[degree]]
    return next(element for element in in_same if element.cell == problem.element.cell)


def _with_volume(element: Element, volume: str) -> Element:
    """Return a Taylor-Hood element with another treatment of the volume term."""
    name = element.name[:2] + ("" if volume == "pointwise" else "P0")
    return replace(element, name=name, volume=volume, pressure_degree=0)


def first_that_fits(elements: Iterable[Element], make: Callable[[Element], T]) -> tuple[Element, T]:
    """Return the first element with which ``make`` succeeds, and what it returns. Collective.

    Raises
    ------
    NoEstimate
        For materials that no element supports, with the reason of the first one.
    """
    reason, degree = "", 0
    for element in elements:
        try:
            return element, make(element)
        except BadInput as error:  # a material without a volume term of its own
            reason, degree = reason or str(error), element.degree
    raise NoEstimateOnAnyMesh(f"no element of degree {degree} fits: {reason}")


def create_in(element: Element, problem: Problem, make: Callable[[Element], Problem]) -> Problem:
    """Return the problem with another element, at its load and state. Collective.

    Its residual is a better one to locate the error with at the run's pressure: at pressure zero
    that of the volume is as large as the pressure.
    """
    other = make(element)
    for term, base in zip(other.terms, problem.terms, strict=True):
        term.share_lengths(base)
    other.interpolate(problem)
    if other.saddle_point is not None:
        without, residual = other.x.copy(), other.x.duplicate()
        other.residual(without, residual)
        norm = residual.norm()
        dofs = other.saddle_point.pressure_dofs(other.x)
        dofs[:] = _pressure(problem, other)[: len(dofs)] / other.saddle_point.unit
        other.residual(other.x, residual)
        if not residual.norm() < _WORSE * norm:
            without.copy(other.x)
    return other


def _pressure(problem: Problem, lifted: Problem) -> np.ndarray:
    """Return nodal pressures [Pa] of the lifted space at the problem's state. Collective.

    They interpolate the run's nodal pressures. Without any, the pressure of a cell is the bulk
    stiffness times its mean change of volume; the pressure of a vertex is the mean over its cells.
    """
    saddle_point, domain = lifted.saddle_point, problem.domain
    assert saddle_point is not None
    target = _dolfinx.function(saddle_point.Q, "pressure")
    if problem.saddle_point is not None:
        source = _dolfinx.function(problem.saddle_point.Q, "pressure")
        source.x.array[:] = problem.saddle_point.pressure()
    else:
        fields = problem.cell_fields(problem.x)
        volumes = fields["volume"]
        pressures = fields["deformed_volume"] / volumes - 1
        for part in lifted.elastic.parts:
            pressures[part.region.cells] *= part.loops.constants.volume_stiffness
        Q = saddle_point.Q if saddle_point.cell_pressures else _dolfinx.function_space(domain, 1)
        source = _dolfinx.function(Q, "pressure")
        sums, weights = (
            summed_over_cells(Q, cells[:, None, None]).ravel()
            for cells in (volumes * pressures, volumes)
        )
        np.divide(sums, weights, out=source.x.array, where=weights > 0)
    target.interpolate(source)
    return np.asarray(target.x.array)


def memory(problem: Problem, element: Element) -> float:
    """Return about how many bytes the lifted problem needs on all ranks. Collective."""
    nodes = len(_dolfinx.reference_nodes(element.cell, element.degree))
    numbers = problem.num_cells * (element.kinematics.components * nodes) ** 2
    return float(_BYTES[problem.kinematics.dim] * numbers)


def available_memory(comm: Any) -> float:
    """Return the memory that is available to the ranks on all machines [bytes]. Collective."""
    here = os.uname().nodename, psutil.virtual_memory().available
    return float(sum(dict(comm.allgather(here)).values()))
