"""Probes: exact on fields the element holds, once on shared faces, told when outside; in runs."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import cube, set_values

import fem_snh
from fem_snh import _dolfinx
from fem_snh.errors import BadInput
from fem_snh.mesh import mesh
from fem_snh.problem.probes import Probes

mpi = pytest.mark.mpi
CELLS = {"Q1": ("hexahedron", 1), "P1": ("tetrahedron", 1)} | {
    "Q2": ("hexahedron", 2),
    "P2": ("tetrahedron", 2),
}


@dataclass
class Point:
    name: str
    point: Any


@dataclass
class Body:
    """What `set_values` and `Probes` need of a problem."""

    V: Any
    u: Any
    x: Any


def body(made: mesh.Mesh, degree: int) -> Body:
    V = _dolfinx.function_space(made.domain, degree, (3,))
    u = _dolfinx.function(V, "u")
    return Body(V, u, _dolfinx.petsc_vec(u))


def quadratic(X: np.ndarray) -> np.ndarray:
    x, y, z = X.T
    return np.stack([x * y + z, y * z - x, z * z + 2 * y], axis=1)


def affine(X: np.ndarray) -> np.ndarray:
    return X @ np.array([[1.0, 2, 3], [-2, 1, 4], [0.5, 0, 1]]) + [1, 2, 3]


#: Inside, on a face, an edge and a corner of cells, and of the body.
POINTS = [
    (0.3, 0.21, 0.87), (0.5, 0.3, 0.4), (0.5, 0.5, 0.2), (0.5, 0.5, 0.5), (1, 0.3, 0.2), (0, 0, 1),
    (1, 1, 1), (0.25, 0.25, 0.25),
]  # fmt: skip


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("element", CELLS)
def test_a_field_that_the_element_holds_is_exact(comm: MPI.Comm, element: str) -> None:
    cell, degree = CELLS[element]
    p = body(cube(comm, cell, cells=4), degree)
    field = quadratic if degree == 2 else affine
    set_values(p, field)
    probes = Probes(p.u, [Point(f"p{i}", point) for i, point in enumerate(POINTS)])
    values = probes.values()
    assert list(values) == [f"p{i}" for i in range(len(POINTS))]
    expected = field(np.array(POINTS, dtype=float))
    assert np.array(list(values.values())) == pytest.approx(expected, abs=1e-13)
    assert comm.allgather(values) == [values] * comm.size
    set_values(p, lambda X: 2 * field(X))  # located once, evaluated again
    assert np.array(list(probes.values().values())) == pytest.approx(2 * expected, abs=1e-13)


@mpi
@pytest.mark.parametrize("point", [(1.001, 0.5, 0.5), (9, 9, 9), (0.5, -0.01, 0.5)])
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_point_outside_is_bad_input_on_every_rank(comm: MPI.Comm, cell: str, point: Any) -> None:
    p = body(cube(comm, cell, cells=2), 1)
    message = (
        rf"^probe 'far': \[{point[0]}.* is outside the body, which extends over "
        r"x = 0..1, y = 0..1, z = 0..1$"
    )
    with pytest.raises(BadInput, match=message):
        Probes(p.u, [Point("near", (0, 0, 0)), Point("far", point)])


# --- in runs -------------------------------------------------------------------------------------


@pytest.mark.one_debian("ranks")
@mpi
def test_probes_of_a_run_are_in_its_record_and_table(comm: MPI.Comm, folder: Path) -> None:
    """A quarter of the top's turn at a quarter of the height; the bottom is constrained."""
    points = [{"name": "foot", "point": [1, 0, 0]}, {"name": "head", "point": [1, 0.5, 1]}]
    setup = {"cells": 2, "angle": 0.4, "probe": points, "progress": False}
    result = fem_snh.run("twist", **setup, out=folder, comm=comm)
    comm.barrier()
    steps = json.loads((folder / "run.json").read_text())["steps"]
    with (folder / "steps.csv").open() as file:
        rows = list(csv.DictReader(file))
    for step, row, mine in zip(steps, rows, result.steps, strict=True):
        angle = 0.4 * step["load"]
        assert step["probes"] == mine["probes"] and list(step["probes"]) == ["foot", "head"]
        assert step["probes"]["foot"] == pytest.approx([0, 0, 0], abs=1e-15)
        expected = [0.5 * (np.cos(angle) - 1), 0.5 * np.sin(angle), 0]
        assert step["probes"]["head"] == pytest.approx(expected, abs=1e-12)
        for name, values in step["probes"].items():
            assert [float(row[f"{name}.{axis}"]) for axis in "xyz"] == values
    comm.barrier()
