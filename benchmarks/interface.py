"""Elements at an interface of two materials, of which one is nearly incompressible."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from benchmarks import Row, split_list
from fem_snh.runs import run
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Scene

#: Stretch along the interface.
STRETCH = 1.3


def layers(element: str, cells: int, ratios: tuple[float, float]) -> Scene:
    """Return two layers [0,1] and [1,2] in x, of one modulus, stretched in y and confined in z."""
    materials = [
        {"name": "stable_neo_hookean", "E": 1.0, "nu": nu, "group": group, "barrier": False}
        for nu, group in zip(ratios, ("first", "second"), strict=True)
    ]
    return Scene(
        name="layers",
        mesh=Geometry(source="bar"),
        cells=cells,
        element=element,
        material=[MaterialChoice.model_validate(table) for table in materials],
        hold=[
            Hold(group="left", components=("x",)),
            Hold(group="front", components=("y",)),
            Hold(group="bottom", components=("z",)),
            Hold(group="top", components=("z",)),
        ],
        move=[Move(group="back", translate=(0, STRETCH - 1, 0), components=("y",))],
        petsc={"snes_scaled_tol": 1e-10},
    )


def exact(problem: Any) -> np.ndarray:
    """Return the displacement [m] of the homogeneous layers: P_xx = 0 gives each one's width."""
    widths = []
    for region in problem.regions:
        mu, lam = region.material.expression.values
        widths.append(STRETCH * (mu + lam) / (mu + lam * STRETCH**2))
    X = problem.coordinates
    x = np.minimum(X[:, 0], 1) * widths[0] + np.maximum(X[:, 0] - 1, 0) * widths[1]
    return np.stack([x - X[:, 0], (STRETCH - 1) * X[:, 1], 0 * x], axis=1)


def rows(
    elements: str = "P2,Q2,P2P0,Q1P0,P2P1,Q2Q1", cells: str = "2,4", soft: float = 0.3
) -> Iterator[Row]:
    """Compare elements with an exact solution: nu = 0.4999 beside a compressible layer.

    Parameters
    ----------
    elements : str
        Names of elements.
    cells : str
        Cells along an edge of length 1, one row each.
    soft : float
        Poisson's ratio of the compressible layer.
    """
    for element in split_list(elements):
        for resolution in map(int, split_list(cells)):
            yield measure(element, resolution, soft)


def measure(element: str, cells: int, soft: float) -> Row:
    """Return the largest errors: of a node, relative to the displacement, and of a cell's J."""
    result = run(layers(element, cells, (0.4999, soft)), progress=False)
    problem, u = result.problem, exact(result.problem)
    found = problem.x.array_r[: u.size].reshape(u.shape)
    fields = problem.cell_fields(problem.x)
    J = (fields["deformed_volume"] / fields["volume"])[problem.regions[0].cells]
    mu, lam = problem.regions[0].material.expression.values
    true = STRETCH**2 * (mu + lam) / (mu + lam * STRETCH**2)
    return {
        "element": element,
        "cells": cells,
        "dofs": problem.dofs,
        "converged": result.converged,
        "newton": result.record["steps"][-1]["newton"],
        "linear": result.record["steps"][-1]["linear"],
        "displacement_error": float(f"{np.abs(found - u).max() / np.abs(u).max():.2e}"),
        "volume_error": float(f"{np.abs(J - true).max():.2e}"),
    }
