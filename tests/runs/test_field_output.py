"""The fields that a scene names: what is written, where, and what is not."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from running import record, solve

from fem_snh import _dolfinx, scenes
from fem_snh.errors import BadInput
from fem_snh.records.output_fields import ON_REQUEST, SUMMED, TENSOR

pyvista = pytest.importorskip("pyvista")
mpi = pytest.mark.mpi
ALL = list(ON_REQUEST)
TWIST = {"scene": "twist", "cells": 2, "angle": 0.8}
USUAL = {"J", "energy_density", "min_eigenvalue"}


def last(folder):
    """The grid of the last load that a run has written."""
    *_, grid = states(folder)
    return grid


def states(folder):
    """Yield the grids of all loads that a run has written."""
    reader = pyvista.get_reader(str(folder / "fields.pvd"))
    for value in reader.time_values:
        reader.set_active_time_value(value)
        yield reader.read().combine()


def gathered(comm, x, values):
    """Coordinates and values of all ranks, in an order that does not depend on the ranks."""
    rows = np.column_stack([x, values.reshape(len(x), -1)])
    return ordered(np.concatenate(comm.allgather(rows)))


def ordered(rows):
    """Rows by their first three columns, rounded: coordinates; each point once."""
    _, first = np.unique(rows[:, :3].round(9), axis=0, return_index=True)
    return rows[first]


def centres(result):
    domain = result.problem.domain
    return _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)].mean(axis=1)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element, at", [("Q1", "cells"), ("P2", "nodes")])
def test_paraview_reads_what_python_computes(comm, folder, element, at):
    result = solve(**TWIST, element=element, fields=ALL, fields_at=at, out=folder)
    comm.barrier()
    grid = last(folder)
    nodal = set(ALL) if at == "nodes" else {"reaction_force"}
    assert set(grid.cell_data.keys()) >= USUAL | set(ALL) - nodal
    corners = 4 if element == "P2" else 8
    nodes = grid.cells.reshape(grid.n_cells, -1)[:, 1 : corners + 1]
    for name, field in ON_REQUEST.items():
        data = grid.point_data if name in nodal else grid.cell_data
        seen = np.asarray(data[name]).reshape(len(data[name]), -1)
        assert seen.shape[1] == max(1, len(field.components))
        if name in nodal:
            x, place = result.problem.V.tabulate_dof_coordinates(), grid.points
        else:
            x, place = centres(result), grid.points[nodes].mean(axis=1)
        expected = gathered(comm, x, result.field(name, at))
        found = ordered(np.column_stack([place, seen]))
        if name in SUMMED:  # over the files of all ranks
            same = np.unique(place.round(9), axis=0, return_inverse=True)[1].ravel()
            found[:, 3:] = 0.0
            np.add.at(found[:, 3:], same, seen)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    assert record(folder)["fields"] == ALL
    comm.barrier()


@pytest.mark.one_debian
def test_components_have_the_names_that_paraview_shows(comm, folder):
    result = solve(**TWIST, fields=["pk1_stress", "principal_stresses"], out=folder)
    comm.barrier()
    arrays = last(folder).GetCellData()
    P, principal = (arrays.GetArray(name) for name in ("pk1_stress", "principal_stresses"))
    assert [P.GetComponentName(i) for i in range(9)] == [c.upper() for c in TENSOR]
    assert [principal.GetComponentName(i) for i in range(3)] == ["1", "2", "3"]
    own = result.field("pk1_stress")
    assert abs(own[:, 0, 1] - own[:, 1, 0]).max() > 0.01  # P is not symmetric: order matters
    comm.barrier()


@pytest.mark.one_debian
def test_without_fields_nothing_of_them_is_imported_or_compiled(tmp_path):
    code = (
        "import sys, fem_snh, os; "
        "r = fem_snh.run('twist', cells=1, steps=1, angle=0.1, out='run', progress=False); "
        "print(sorted(m for m in sys.modules if m.startswith('fem_snh.') and "
        "m.rpartition('.')[2] in ('stress_fields', 'stress_loops', 'field_values', "
        "'nodal_projection', 'requested_fields', 'point_fields', "
        "'obstacle_contact', 'friction', 'surface_quadrature', 'dynamics'))); "
        "print('fields' in r.record)"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.split("\n")[:2] == ["[]", "False"]
    assert set(last(tmp_path / "run").array_names) >= USUAL | {"displacement"}
    assert not set(last(tmp_path / "run").array_names) & set(ALL)


@pytest.mark.parametrize(
    "keys, message",
    [
        ({"fields": ["von_mses"]}, r"fields = 'von_mses': expected one of .* mean 'von_mises'"),
        ({"fields": ["J"]}, r"fields = 'J': expected one of "),
        ({"fields": 3}, r"fields = 3: expected a list of names of fields"),
        ({"fields": [3]}, r"fields = \[3\]: expected a list of names of fields"),
        ({"fields_at": "points"}, r"fields_at = 'points': expected one of cells, nodes"),
        ({"fields_at": 1}, r"fields_at = 1: expected one of cells, nodes"),
    ],
)  # fmt: skip
def test_mistakes(keys, message):
    with pytest.raises(BadInput, match=message):
        scenes.load("twist", **keys)
