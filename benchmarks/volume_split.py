"""The bound b of `fem_snh.materials.volume_split`: stability and Newton iterations by element."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI

import numpy as np

from benchmarks import Row, split_list
from benchmarks.manufactured import bent_cube
from benchmarks.quadrature import dense, spurious_modes
from fem_snh.assembly.elements import ELEMENTS, Element, element
from fem_snh.assembly.regions import Filling
from fem_snh.kernels.material import material
from fem_snh.linalg.direct_solver import DIRECT_SOLVER
from fem_snh.materials.parameters import BOUNDS
from fem_snh.problem.definition import Definition
from fem_snh.runs import run
from fem_snh.scenes import Hold, Move


def rows(
    elements: str = "",
    bounds: str = "0,1,2,4,10",
    stretches: str = "1.5,1,0.8,0.7,0.6,0.5,0.4",
    nu: float = 0.4999,
    cells: int = 0,
    hessian: str = "adaptive",
) -> Iterator[Row]:
    """Yield one row per mixed element and bound, and one for each other element.

    Yields
    ------
    dict
        ``spurious``: zero-energy modes of a free patch of cells at rest, without the rigid ones.
        ``least``: smallest eigenvalue of the exact stiffness of 2 x 2 x 2 cells [E m] in the exact
        uniaxial state of each stretch with free sides; where it is negative, the cells buckle.
        ``newton``, ``energy``, ``min_J``: of the two quarter turns of the twist at nu = 0.49.
    """
    for name in split_list(elements) or ELEMENTS:
        kind = element(name)
        mixed = kind.volume != "pointwise"
        for bound in split_list(bounds) if mixed else [""]:
            with split_at(float(bound) if mixed else None):
                row: Row = {"element": name, "bound": float(bound) if mixed else None}
                row["spurious"] = spurious_modes(kind, bent_cube(MPI.COMM_SELF, kind.cell, 2, 0.02))
                row["least"] = {
                    s: least_eigenvalue(kind, float(s), nu) for s in split_list(stretches)
                }
                yield row | twist(kind, cells or (3 if kind.degree == 2 else 6), hessian)


@contextmanager
def split_at(bound: float | None) -> Iterator[None]:
    """Give mixed elements that are created in this context another bound."""
    original = dict(BOUNDS)
    if bound is not None:
        BOUNDS.update(dict.fromkeys(BOUNDS, bound))
    try:
        yield
    finally:
        BOUNDS.update(original)


def least_eigenvalue(kind: Element, stretch: float, nu: float) -> float:
    """Return the smallest eigenvalue of the stiffness without pressures, in a uniaxial state."""
    chosen = material("stable_neo_hookean", E=1.0, nu=nu, barrier=False)
    p = Definition(
        bent_cube(MPI.COMM_SELF, kind.cell, 2, 0.0),
        kind,
        [Filling(chosen)],
        [
            Hold(group="left", components=("x",)),
            Hold(group="front", components=("y",)),
            Hold(group="bottom", components=("z",)),
            Move(group="right", translate=(stretch - 1, 0, 0), components=("x",)),
        ],
    ).problem()
    mu, lam = chosen.expression.values
    J = 1 + mu / lam * (1 - 1 / stretch)
    X = p.coordinates
    lateral = (J / stretch) ** 0.5
    p.x.array[: X.size] = (X * (np.array([stretch, lateral, lateral]) - 1)).ravel()
    if p.saddle_point:
        p.saddle_point.pressure_dofs(p.x)[:] = (
            p.elastic.parts[0].loops.constants.volume_stiffness * (J - 1) * p.length
        )
    p.jacobian(p.x, "exact")
    A = dense(p.A)
    n = X.size
    K, B, C = A[:n, :n], A[n:, :n], -A[n:, n:]
    reduced = K + B.T @ np.linalg.solve(C, B) if len(C) else K
    return round(float(np.linalg.eigvalsh(reduced)[0]), 5)


def twist(kind: Element, cells: int, hessian: str) -> Row:
    """Return the results of the twist with direct solvers."""
    result = run(
        "twist",
        element=kind.name,
        nu=0.49,
        cells=cells,
        hessian=hessian,
        globalization="linesearch",
        petsc=DIRECT_SOLVER,
        progress=False,
    )
    row: Row = {key: [step[key] for step in result.steps] for key in ("newton", "energy", "min_J")}
    return {"cells": cells, "converged": result.converged} | row
