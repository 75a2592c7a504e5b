"""Probes: exact on fields the element holds, once on shared faces, told when outside; in runs."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import cube

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import BadInput
from fem_snh.problem.probes import Probes
from fem_snh.scenes import Probe

mpi = pytest.mark.mpi


def field(x: np.ndarray, degree: int) -> np.ndarray:
    """A polynomial of degree 1 or 2 of points (3, n)."""
    if degree == 2:
        return np.stack([x[0] * x[1] + x[2], x[1] * x[2] - x[0], x[2] * x[2] + 2 * x[1]])
    return np.array([[1, -2, 0.5], [2, 1, 0], [3, 4, 1]]) @ x + [[1], [2], [3]]


#: Inside, on a face, an edge and a corner of cells, and of the body.
POINTS = [
    (0.3, 0.21, 0.87), (0.5, 0.3, 0.4), (0.5, 0.5, 0.2), (0.5, 0.5, 0.5), (1, 0.3, 0.2), (0, 0, 1),
    (1, 1, 1), (0.25, 0.25, 0.25),
]  # fmt: skip


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("element", ["Q1", "P1", "Q2", "P2"])
def test_a_field_that_the_element_holds_is_exact(comm: MPI.Comm, element: str) -> None:
    cell, degree = ELEMENTS[element].cell, ELEMENTS[element].degree
    domain = cube(comm, cell, cells=4).domain
    u = _dolfinx.function(_dolfinx.function_space(domain, degree, (3,)), "u")
    u.interpolate(lambda x: field(x, degree))
    probes = Probes(u, [Probe(name=f"p{i}", point=point) for i, point in enumerate(POINTS)])
    values = probes.values()
    assert list(values) == [f"p{i}" for i in range(len(POINTS))]
    expected = field(np.array(POINTS, dtype=float).T, degree).T
    assert np.array(list(values.values())) == pytest.approx(expected, abs=1e-13)
    assert comm.allgather(values) == [values] * comm.size
    u.interpolate(lambda x: 2 * field(x, degree))  # located once, evaluated again
    assert np.array(list(probes.values().values())) == pytest.approx(2 * expected, abs=1e-13)


@mpi
@pytest.mark.parametrize("point", [(1.001, 0.5, 0.5), (9, 9, 9), (0.5, -0.01, 0.5)])
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_a_point_outside_is_bad_input_on_every_rank(comm: MPI.Comm, cell: str, point: Any) -> None:
    V = _dolfinx.function_space(cube(comm, cell, cells=2).domain, 1, (3,))
    message = (
        rf"^probe 'far': \[{point[0]}.* is outside the body, which extends over "
        r"x = 0..1, y = 0..1, z = 0..1$"
    )
    with pytest.raises(BadInput, match=message):
        near, far = Probe(name="near", point=(0, 0, 0)), Probe(name="far", point=point)
        Probes(_dolfinx.function(V, "u"), [near, far])


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
