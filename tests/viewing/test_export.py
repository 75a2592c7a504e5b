"""Exports are read back: one VTKHDF file is what the .pvd is, OBJ files are closed surfaces.

Exports that cannot be made are one line, and leave no file behind.
"""

from __future__ import annotations

import json
import math
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import pyvista as pv
from picture_runs import CELLS, bad, write_run
from scipy.spatial import cKDTree
from vtkmodules.vtkCommonExecutionModel import vtkStreamingDemandDrivenPipeline
from vtkmodules.vtkIOHDF import vtkHDFReader

from fem_snh.errors import on_root
from fem_snh.viewing import export
from fem_snh.viewing.states import States

LOADS = (0.0, 0.5, 1.0)
#: Cells of the cube, and triangles of its surface at the first degree.
COUNTS = {"P1": (162, 108), "P2": (162, 432), "Q1": (27, 108), "Q2": (27, 432)}


def read_vtkhdf(path: Path) -> dict[float, Any]:
    """Return the grids of a temporal VTKHDF file by time, as VTK reads them."""
    reader = vtkHDFReader()
    reader.SetFileName(str(path))
    reader.UpdateInformation()
    times = reader.GetOutputInformation(0).Get(vtkStreamingDemandDrivenPipeline.TIME_STEPS())
    grids = {}
    for time in times:
        reader.UpdateTimeStep(time)
        grids[time] = pv.wrap(reader.GetOutputDataObject(0)).copy()
    return grids


def read_pvd(folder: Path) -> dict[float, Any]:
    """Return the grids of a run by load, as PyVista reads them: points of several ranks twice."""
    reader: Any = pv.get_reader(folder / "fields.pvd")
    grids = {}
    for load in reader.time_values:
        reader.set_active_time_value(load)
        grids[load] = reader.read()[0]
    return grids


def check_same(found: Any, expected: Any) -> None:
    """Compare two grids point by point and cell by cell, whatever their order."""
    if "vtkGhostType" in expected.cell_data:
        expected = expected.extract_cells(expected.cell_data["vtkGhostType"] == 0)
    distance, points = cKDTree(found.points).query(expected.points)
    assert distance.max() < 1e-15
    u, wanted = found["displacement"][points], expected["displacement"]
    assert u.dtype == np.float64 and np.abs(u - wanted).max() < 1e-15

    assert found.n_cells == expected.n_cells
    distance, cells = cKDTree(found.cell_centers().points).query(expected.cell_centers().points)
    assert distance.max() < 1e-6 and len(set(cells)) == len(cells)
    assert np.array_equal(found.celltypes[cells], expected.celltypes)
    nodes = [g.points[g.cell_connectivity].reshape(g.n_cells, -1, 3) for g in (found, expected)]
    assert np.abs(nodes[0][cells] - nodes[1]).max() < 1e-15
    fields = {name for name in expected.cell_data.keys() if not name.startswith("vtk")}
    assert set(found.cell_data.keys()) == fields >= {"J", "energy_density", "min_eigenvalue"}
    for name in fields:
        assert np.array_equal(found.cell_data[name][cells], expected.cell_data[name])


@pytest.mark.mpi
@pytest.mark.parametrize("element", COUNTS)
def test_vtkhdf_is_what_the_pvd_is(comm, folder, element):
    write_run(comm, folder, element)

    def check() -> None:
        (path,) = export.main(folder, folder / "run.vtkhdf")
        found, expected = read_vtkhdf(path), read_pvd(folder)
        assert tuple(found) == LOADS == tuple(expected)
        for load in LOADS:
            assert found[load].n_points == (CELLS * int(element[1]) + 1) ** 3
            assert found[load].n_cells == COUNTS[element][0]
            check_same(found[load], expected[load])

    on_root(comm, check)


#: h5py needs a process without dolfinx, which loads another HDF5 library.
_READ = """
import sys, h5py
with h5py.File(sys.argv[1]) as file:
    print(len(file["VTKHDF/Points"]), file["fem_snh/run.json"].asstr()[()])
"""


def test_vtkhdf_has_the_mesh_once_and_the_record(twisted):
    (path,) = export.main(twisted, twisted / "run.vtkhdf")
    command = [sys.executable, "-c", _READ, str(path)]
    output = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    points, record = output.split(maxsplit=1)
    assert int(points) == (CELLS + 1) ** 3
    assert json.loads(record) == json.loads((twisted / "run.json").read_text())


@pytest.fixture
def twisted(tmp_path: Path) -> Path:
    return write_run(MPI.COMM_SELF, tmp_path / "run", "Q1")


def rewrite(folder: Path, state: int, change: Any) -> Any:
    """Replace the piece of a state by ``change`` of its grid, or change it; return the grid."""
    path = folder / f"fields_p0_{state:06}.vtu"
    grid: Any = pv.read(path)
    grid = change(grid) or grid
    grid.save(path)
    return grid


@pytest.mark.one_debian
def test_tensors_have_nine_components_and_nodes_have_forces(twisted):
    def add(grid: Any) -> None:
        random = np.random.default_rng(grid.n_points)
        grid.cell_data["cauchy_stress"] = random.random((grid.n_cells, 9))
        grid.point_data["reaction_force"] = random.random((grid.n_points, 3))

    expected = [rewrite(twisted, state, add) for state in range(3)]
    (path,) = export.main(twisted, twisted / "run.vtkhdf")
    for grid, wanted in zip(read_vtkhdf(path).values(), expected, strict=True):
        assert grid.cell_data["cauchy_stress"].shape == (27, 9)
        assert np.array_equal(grid.cell_data["cauchy_stress"], wanted["cauchy_stress"])
        assert np.array_equal(grid.point_data["reaction_force"], wanted["reaction_force"])


def test_states_of_other_ranks_are_on_the_same_mesh(twisted):
    """A run resumed on another number of ranks: simulated by another order in one file."""
    states = States(twisted / "fields.pvd")
    expected = states.read(1)

    def shuffle(grid: Any) -> Any:
        random = np.random.default_rng(0)
        points, cells = random.permutation(grid.n_points), random.permutation(grid.n_cells)
        rank = np.argsort(points)
        nodes = grid.cell_connectivity.reshape(grid.n_cells, -1)[cells]
        other = pv.UnstructuredGrid({grid.celltypes[0]: rank[nodes]}, grid.points[points])
        other.point_data["displacement"] = grid.point_data["displacement"][points]
        for name in ("J", "min_J", "energy_density", "min_eigenvalue"):
            other.cell_data[name] = grid.cell_data[name][cells]
        return other

    shuffled = rewrite(twisted, 1, shuffle)
    assert not np.array_equal(shuffled["J"], expected.cell_data["J"])
    found = states.read(1)
    for name, values in {**expected.point_data, **expected.cell_data}.items():
        assert np.array_equal({**found.point_data, **found.cell_data}[name], values)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return the vertices and the triangles of an OBJ file."""
    lines = [line.split() for line in path.read_text().splitlines()]
    points = np.array([line[1:] for line in lines if line[0] == "v"], dtype=float)
    return points, np.array([line[1:] for line in lines if line[0] == "f"], dtype=int) - 1


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the volume that a surface encloses, by the divergence theorem."""
    a, b, c = points[triangles].transpose(1, 0, 2)
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


@pytest.mark.one_debian("serial")
@pytest.mark.mpi
@pytest.mark.parametrize("element", COUNTS)
def test_obj_surfaces_are_closed_and_twisted(comm, folder, element):
    write_run(comm, folder, element)

    def check() -> None:
        paths = export.main(folder, folder / "surface" / "a.obj")
        assert [path.name for path in paths] == ["a_0000.obj", "a_0001.obj", "a_0002.obj"]
        for path, load in zip(paths, LOADS, strict=True):
            points, triangles = read_obj(path)
            edges = np.concatenate([triangles[:, [i, (i + 1) % 3]] for i in range(3)]).tolist()
            directed = {tuple(edge) for edge in edges}
            # Each edge is between two triangles that pass it in opposite directions.
            assert len(directed) == len(edges) and {(b, a) for a, b in directed} == directed
            assert len(triangles) == COUNTS[element][1] == 2 * len(points) - 4  # Euler: a sphere
            # The inverse of the twist makes it the cube.
            angle, (x, y) = -math.pi * load * points[:, 2], points[:, :2].T - 0.5
            cos, sin = np.cos(angle), np.sin(angle)
            cube = np.array([cos * x - sin * y + 0.5, sin * x + cos * y + 0.5, points[:, 2]]).T
            assert np.abs(np.minimum(abs(cube), abs(cube - 1)).min(axis=1)).max() < 1e-9
            assert volume(cube, triangles) == pytest.approx(1, abs=1e-9)
            if element == "P1":  # whose faces are flat
                grid = read_pvd(folder)[load]
                ghost = grid.cell_data.get("vtkGhostType", np.zeros(grid.n_cells))
                nodes = grid.cell_connectivity.reshape(-1, 4)[np.asarray(ghost) == 0]
                corners = (grid.points + grid["displacement"])[nodes]
                volumes = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6
                assert volume(points, triangles) == pytest.approx(abs(volumes).sum(), abs=1e-9)

    on_root(comm, check)


# --- what cannot be exported --------------------------------------------------------------------


def test_a_bad_state_leaves_the_earlier_file(twisted, tmp_path):
    (path,) = export.main(twisted, tmp_path / "a.vtkhdf")
    content = path.read_bytes()
    rewrite(twisted, 2, lambda grid: grid.cell_data.remove("J"))
    assert re.search("its fields are .*, those of the first load", bad(export.main, twisted, path))
    rewrite(twisted, 1, lambda grid: grid.scale(2, inplace=True))
    states = States(twisted / "fields.pvd")
    assert "its mesh is not that of the other loads" in bad(states.read, 1)
    (twisted / "fields_p0_000001.vtu").unlink()
    assert "missing" in bad(export.main, twisted, path)
    assert path.read_bytes() == content
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.vtkhdf", "run"]


@pytest.mark.parametrize(("part", "why"), [(0.5, "truncated"), (0.05, "damaged")])
def test_a_truncated_file_is_one_line(twisted, tmp_path, capfd, part, why):
    """VTK prints several lines of its own; one file has no data, the other no complete header."""
    file = twisted / "fields_p0_000001.vtu"
    file.write_bytes(file.read_bytes()[: int(part * file.stat().st_size)])
    message = bad(export.main, twisted, tmp_path / "a.vtkhdf")
    assert message.startswith(f"{file}: cannot be read: it is ") and why in message
    assert capfd.readouterr() == ("", "")
