"""The contact patch test of two cubes: how far from affine their displacement is."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from benchmarks import Row, split_list
from fem_snh import _dolfinx
from fem_snh.choices import CONTACT_METHODS
from fem_snh.problem.problem import Problem
from fem_snh.runs import run
from fem_snh.scenes import Contact, Geometry, Hold, MaterialChoice, Move, Scene

#: Bulk and shear modulus, and the displacement of the top (LLNL's two-cube contact patch).
BULK, SHEAR, PRESS = 10.0, 0.25, 0.01
E = 9 * BULK * SHEAR / (3 * BULK + SHEAR)
NU = (3 * BULK - 2 * SHEAR) / (2 * (3 * BULK + SHEAR))
#: Largest distance from an affine displacement, in that of the top: with the augmented Lagrangian
#: and this tolerance (of V^(1/3)), or with a hundred times the default stiffness. A smaller one
#: leaves more.
LIMIT, TOLERANCE = 1e-3, 1e-6


def blocks(element: str, cells: int, upper_cells: int, contact: Contact) -> Scene:
    """Return two unit cubes, one above the other, pressed between frictionless plates."""
    constants = {"name": "stable_neo_hookean", "E": E, "nu": NU}
    return Scene(
        name="contact_patch",
        mesh=Geometry(source="two_blocks", parameters={"upper_cells": upper_cells}),
        cells=cells,
        element=element,
        material=[
            MaterialChoice.model_validate({**constants, "group": group})
            for group in ("lower", "upper")
        ],
        hold=[
            Hold(group="bottom", components=("z",)),
            Hold(group="left", components=("x",)),
            Hold(group="front", components=("y",)),
        ],
        move=[Move(group="top", translate=(0, 0, -PRESS), components=("z",))],
        contact=[contact],
        petsc={"snes_scaled_tol": 1e-10},
    )


def rows(
    elements: str = "Q1,P1,Q2,P2",
    cells: int = 2,
    upper: str = "2,3",
    stiffness: str = "1,10,100",
    methods: str = ",".join(CONTACT_METHODS),
) -> Iterator[Row]:
    """Press two cubes together: one row per element, upper mesh, method and stiffness.

    Parameters
    ----------
    elements : str
        Names of elements.
    cells : int
        Cells along an edge of the lower cube.
    upper : str
        Cells along an edge of the upper cube.
    stiffness : str
        Stiffnesses of the penalty in the default one, 10 E over the height of a cell; the augmented
        Lagrangian has the default one.
    methods : str
        Of `fem_snh.choices.CONTACT_METHODS`.
    """
    for element in split_list(elements):
        for upper_cells in map(int, split_list(upper)):
            for method in split_list(methods):
                for factor in split_list(stiffness if method == "penalty" else "1"):
                    yield measure(element, (cells, upper_cells), float(factor), method)


def measure(element: str, cells: tuple[int, int], factor: float, method: str) -> Row:
    """Return the distance from an affine displacement, relative to that of the top."""
    k = 10 * factor * E * min(cells)
    tolerance = None if method == "penalty" else TOLERANCE
    contact = Contact(
        groups=("lower_top", "upper_bottom"), method=method, stiffness=k, tolerance=tolerance
    )
    result = run(blocks(element, *cells, contact), progress=False)
    (step,) = result.record["steps"]
    (pair,) = step["contacts"].values()
    error = max(distances_from_affine(result.problem)) / PRESS
    return {
        "element": element,
        "cells": list(cells),
        "matching": cells[0] == cells[1],
        "dofs": result.problem.dofs,
        "method": method,
        "stiffness": factor,
        "error": error,
        "force": -pair["force"][2],
        "penetration": pair["penetration"],
        "contacts": pair["contacts"],
        "newton": step["newton"],
        "linear": step["linear"],
        "solves": step["solves"],
        "limit": LIMIT,
        "ok": bool(result.converged and (error <= LIMIT or (factor < 100 and tolerance is None))),
    }


def distances_from_affine(problem: Problem) -> list[float]:
    """Return, for each region, the largest distance of a node from the affine least-squares fit."""
    V, found = problem.V, []
    X, u = V.tabulate_dof_coordinates(), problem.u.x.array.reshape(-1, 3)
    for region in problem.regions:
        nodes = np.unique(_dolfinx.node_dofs(V)[region.cells])
        parts = problem.comm.allgather((X[nodes], u[nodes]))
        points, values = map(np.concatenate, zip(*parts, strict=True))
        A = np.column_stack([points, np.ones(len(points))])
        fit = A @ np.linalg.lstsq(A, values, rcond=None)[0]
        found.append(float(np.abs(fit - values).max()))
    return found
