"""Quadrature degree of each element: spurious modes, volume errors, accuracy, assembly time."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.sparse import csr_matrix

from benchmarks import Row, split_list
from benchmarks.assembly import times
from benchmarks.manufactured import Manufactured, bent_cube
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS, Element, element
from fem_snh.assembly.regions import Filling
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.problem.definition import Definition
from fem_snh.problem.problem import Problem

#: Cells along the edge of the cube, by the degree of the displacement.
CELLS = {1: 8, 2: 5}


def rows(
    elements: str = "", nus: str = "0.3,0.4999", cells: int = 0, repeat: int = 7
) -> Iterator[Row]:
    """Yield one row per element and rule; ``ok`` if the default rule has no spurious modes.

    Yields
    ------
    dict
        ``least_weight``: smallest weight (their sum is 1); with a negative one a filtered matrix
        can be indefinite. ``spurious``: zero or negative eigenvalues of one cell at rest beyond
        rigid motions and pressures. ``volume_error``: of a body whose inner nodes are moved.
        ``error``: ||grad(u - u_h)|| of the manufactured solution at each of ``nus``; ``newton``:
        iterations; None without convergence. ``cost``: processor time of the clamped Jacobian
        relative to the default rule.
    """
    for name in split_list(elements) or ELEMENTS:
        default = element(name)
        for degree in degrees(default):
            yield measure(default, degree, [float(nu) for nu in split_list(nus)], cells, repeat)


def degrees(default: Element) -> list[int]:
    """Return degrees around the default, the highest one for each number of points."""
    near = range(max(default.quadrature - 2, default.least), default.quadrature + 3)
    return sorted({points(element(default.name, degree)): degree for degree in near}.values())


def points(kind: Element) -> int:
    """Return the number of quadrature points of a cell."""
    return len(_dolfinx.quadrature(kind.cell, kind.quadrature)[1])


def measure(default: Element, degree: int, nus: list[float], cells: int, repeat: int) -> Row:
    """Return the row of an element and a degree."""
    kind, cells = element(default.name, degree), cells or CELLS[default.degree]
    spurious = spurious_modes(kind, one_cell(kind))
    weights = _dolfinx.quadrature(kind.cell, degree)[1]
    row: Row = {
        "element": kind.name,
        "degree": degree,
        "points": len(weights),
        "default": len(weights) == points(default),
        "least_weight": round(float(weights.min() / weights.sum()), 4),
        "spurious": spurious,
        "volume_error": volume_error(kind),
        "error": {},
        "newton": {},
    }
    for nu in nus:
        found = Manufactured(kind, cells, nu)
        try:
            row["newton"][nu] = found.solve()
            row["error"][nu] = found.errors()[1]
        except BadInput:
            row["newton"][nu] = row["error"][nu] = None
    other = Manufactured(default, cells, nus[0])
    taken = times({"this": jacobian(found.problem), "default": jacobian(other.problem)}, repeat)
    row["cost"] = round(float(np.median(taken["this"] / taken["default"])), 2)
    return row | {"ok": not (row["default"] and spurious)}


def jacobian(problem: Problem) -> Any:
    """Return a call that assembles the filtered Jacobian at rest."""
    problem.x.set(0.0)
    return lambda: problem.jacobian(problem.x, "clamp")


def one_cell(kind: Element) -> mesh.Mesh:
    """Return a mesh of one distorted cell."""
    corners = _dolfinx.reference_corners(kind.cell)
    x = corners @ np.array([[1.1, 0.2, 0.1], [0, 0.9, -0.2], [0.1, 0, 1.2]]) + 0.1 * corners**2
    domain = _dolfinx.create_mesh(MPI.COMM_SELF, np.arange(len(x))[None], x, kind.cell, 1)
    return mesh.Mesh(domain, kind.cell, (), 1)


def spurious_modes(kind: Element, body: mesh.Mesh, nu: float = 0.3) -> int:
    """Count zero eigenvalues beyond rigid motions and negative ones beyond pressures, at rest."""
    p = Definition(body, kind, [Filling(_material(nu))]).problem()
    p.jacobian(p.x, "exact")
    values = np.linalg.eigvalsh(dense(p.A))
    zero = abs(values) <= 1e-12 * values[-1]
    pressures = p.dofs - 3 * _dolfinx.num_nodes(p.V)[0]
    return int(zero.sum() - 6 + abs((values[~zero] < 0).sum() - pressures))


def dense(A: Any) -> np.ndarray:
    """Return a matrix of one rank as a dense array."""
    indptr, indices, entries = A.getValuesCSR()
    return np.asarray(csr_matrix((entries, indices, indptr)).toarray())


def volume_error(kind: Element) -> float:
    """Return the error of the volume when inner nodes move and the boundary does not."""
    body = bent_cube(MPI.COMM_SELF, kind.cell, 3, 0.02)
    p = Definition(body, kind, [Filling(_material(0.3))]).problem()
    X = p.V.tabulate_dof_coordinates()
    inside = 64 * (X * (1 - X)).prod(axis=1, keepdims=True)
    moved = 0.1 * inside * np.sin(X @ np.array([[2.0, 5, 3], [3, 1, 4], [5, 3, 2]]) + 0.3)
    p.x.array[: moved.size] = moved.ravel()
    return abs(p.measures(p.x)["volume_ratio"] - 1)


def _material(nu: float) -> Any:
    return material("stable_neo_hookean", E=1.0, nu=nu, barrier=False)
