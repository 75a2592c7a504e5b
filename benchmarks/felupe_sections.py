"""Sections beside FElupe: displacements of the nodes, of both programs' own fields and energies.

It needs felupe (``pip install felupe pypardiso``), here or in an environment of its own, whose
Python the option ``python`` names.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import ufl
from dolfinx import fem, mesh

import fem_snh
from benchmarks import Row, split_list
from benchmarks.felupe_section_program import MOVED, NU, E, distort
from benchmarks.felupe_twist import run_felupe
from fem_snh import _dolfinx
from fem_snh.errors import BadInput

#: Largest difference of displacements, on a square of side 1.
LIMIT = 1e-10


def rows(cells: str = "3,12", python: str = sys.executable, out: str = "") -> Iterator[Row]:
    """Yield one row per kinematics, element and mesh.

    Parameters
    ----------
    cells : comma list
        Cells along a side of the square.
    python : str
        The Python that has FElupe.
    out : str
        A file, to which the displacements of FElupe are written, for the tests.

    Yields
    ------
    dict
        The largest difference of the nodes' displacements, ``largest`` the largest of them.
    """
    written: dict[str, Any] = {}
    for kinematics in MOVED:
        for element in ("Q1", "Q2"):
            for number in map(int, split_list(cells)):
                theirs = run_felupe(
                    "felupe_section_program.py", python, [element, kinematics, number]
                )
                written[f"{element} {kinematics} {number}"] = theirs
                points, expected = (np.array(theirs[k]) for k in ("points", "displacements"))
                difference = abs(displacements(element, kinematics, number, points) - expected)
                yield {
                    "kinematics": kinematics,
                    "element": element,
                    "cells": number,
                    "largest": float(abs(expected).max()),
                    "difference": float(difference.max()),
                    "felupe_version": theirs["version"],
                    "limit": LIMIT,
                    "ok": bool(difference.max() < LIMIT),
                }
    if out:
        Path(out).write_text(json.dumps(written) + "\n", encoding="utf-8")


def displacements(element: str, kinematics: str, cells: int, points: np.ndarray) -> np.ndarray:
    """Return the displacements (n, 2) of nodes at these points (n, 2), of a mesh like FElupe's."""
    domain = mesh.create_unit_square(
        MPI.COMM_SELF, cells, cells, cell_type=mesh.CellType.quadrilateral
    )
    x = domain.geometry.x
    x[:, 0], x[:, 1] = distort(x[:, 0], x[:, 1])
    V = _dolfinx.function_space(domain, int(element[1]), (2,))
    u = _dolfinx.function(V, "u")
    bcs = []
    for height, value in ((0.0, (0.0, 0.0)), (1.0, MOVED[kinematics])):
        nodes = fem.locate_dofs_geometrical(V, lambda x, y=height: np.isclose(x[1], y))
        bcs.append(fem.dirichletbc(np.array(value), nodes, V))
    rubber = fem_snh.material("neo_hookean_bower", E=E, nu=NU)
    problem = fem_snh.NonlinearProblem(
        u, {rubber: ufl.dx}, bcs=bcs, element=element, kinematics=kinematics,
        petsc_options={"snes_scaled_tol": 1e-13},
    )  # fmt: skip
    problem.solve()
    if problem.solver.getConvergedReason() <= 0:
        raise BadInput(f"{element}, {kinematics}: {problem.reason}")
    nodes = V.tabulate_dof_coordinates()[:, :2]
    distance = np.linalg.norm(points[:, None] - nodes[None], axis=2)
    if (found := distance.min(axis=1).max()) > LIMIT:
        raise BadInput(f"the meshes differ by {found:g}")
    values: np.ndarray = u.x.array.reshape(-1, 2)[distance.argmin(axis=1)]
    return values
