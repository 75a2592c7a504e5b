"""Runs with known fields and records, for the tests of pictures and graphs."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from mpi4py import MPI

import dolfinx
import numpy as np
import pytest
import ufl

from fem_snh import _dolfinx
from fem_snh.errors import BadInput, on_root
from fem_snh.runs.output.fields import GridSeries
from fem_snh.runs.output.vtu import DataArray

CELLS = 3  # along an edge of the cube


def record(loads: tuple[float, ...] = (0.5, 1.0), **changes: Any) -> dict[str, Any]:
    """Return the content of run.json as a run writes it."""
    steps = [
        {"load": t, "converged": True, "newton": 10 + i, "linear": 100 * (i + 1),
         "volume_ratio": 1 + 0.04 * t, "min_J": 0.9, "seconds": 1.0}
        for i, t in enumerate(loads)
    ]  # fmt: skip
    return {
        "scene": "twist",
        "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.49},
        "element": "Q1", "hessian": "adaptive", "cells": 27, "steps": steps,
        "load_name": "angle", "load_range": [0.0, math.pi],
    } | changes  # fmt: skip


def write_record(folder: Path, content: dict[str, Any]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(json.dumps(content))
    return folder


def nodal_arrays(functions: list[Any]) -> list[DataArray]:
    """The values of vector functions at their nodes."""
    return [DataArray(u.name, u.x.array.reshape(-1, 3).copy()) for u in functions]


def write_run(comm: MPI.Intracomm, folder: Path, element: str) -> Path:
    """A run folder with the fields of a twisted unit cube, by dolfinx. Collective."""
    cell = {"Q": dolfinx.mesh.CellType.hexahedron, "P": dolfinx.mesh.CellType.tetrahedron}
    domain = dolfinx.mesh.create_unit_cube(comm, CELLS, CELLS, CELLS, cell[element[0]])
    u = dolfinx.fem.Function(_dolfinx.function_space(domain, int(element[1]), (3,)))
    u.name = "displacement"
    per_cell = _dolfinx.function_space(domain, 0, (), "DG")
    names = ("J", "min_J", "energy_density", "min_eigenvalue")
    fields = {name: dolfinx.fem.Function(per_cell, name=name) for name in names}
    J = ufl.det(ufl.Identity(3) + ufl.grad(u))

    on_root(comm, lambda: folder.mkdir(parents=True, exist_ok=True))
    file = GridSeries(folder / "fields.pvd", u.function_space)
    cells = _dolfinx.node_dofs(per_cell)[:, 0]
    for t in (0.0, 0.5, 1.0):

        def twist(x: np.ndarray, t: float = t) -> np.ndarray:
            angle, a, b = math.pi * t * x[2], x[0] - 0.5, x[1] - 0.5
            c, s = np.cos(angle), np.sin(angle)
            return np.array([c * a - s * b - a, s * a + c * b - b, 0 * a])

        u.interpolate(twist)
        for field in fields.values():
            _dolfinx.interpolate(field, J)
        values = [DataArray(name, field.x.array[cells]) for name, field in fields.items()]
        file.write(t, nodal_arrays([u]), values)
    on_root(comm, write_record, folder, record(element=element))
    comm.barrier()  # all ranks' pieces are there
    return folder


def bad(function: Any, *args: Any) -> str:
    with pytest.raises(BadInput) as caught:
        function(*args)
    message = str(caught.value)
    assert message and "\n" not in message
    return message
