"""Files of the modes, and errors that are found before the load steps."""

from __future__ import annotations

import csv
import json
import subprocess
import sys

from mpi4py import MPI

import numpy as np
import pytest

import fem_snh
from fem_snh.errors import BadInput
from fem_snh.scenes import Geometry

mpi = pytest.mark.mpi


def solve(scene="modes", comm=MPI.COMM_WORLD, **kwargs):
    return fem_snh.run(scene, comm=comm, progress=False, **kwargs)


# --- files ---------------------------------------------------------------------------------------


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_record_table_and_shapes(comm, folder, element):
    import pyvista

    count = 4
    result = solve(cells=3, count=count, aspect=2.0, element=element, density=500.0, out=folder)
    comm.barrier()
    modes = json.loads((folder / "run.json").read_text())["modes"]
    assert modes == result.record["modes"]
    assert modes["density"] == 500 and modes["frequencies"] == result.frequencies
    assert len(modes["residuals"]) == count and max(modes["residuals"]) < 1e-9
    seconds = result.record["seconds"]
    assert min(seconds.values()) >= 0 and seconds["modes"] > 0
    with (folder / "modes.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [float(row["frequency"]) for row in rows] == result.frequencies
    assert [int(row["mode"]) for row in rows] == [1, 2, 3, 4]
    reader = pyvista.get_reader(str(folder / "modes.pvd"))
    assert reader.time_values == [1, 2, 3, 4]
    for number in (1, 4):
        reader.set_active_time_value(number)
        grid = reader.read().combine()
        assert grid.n_cells == result.record["cells"]
        mode = grid.point_data["mode"]
        assert not grid.point_data["displacement"].any()
        assert not mode[grid.points[:, 0] < 1e-9].any() and abs(mode).max() > 0
    comm.barrier()
    again = solve("twist", cells=1, angle=0.1, out=folder, overwrite=True)
    comm.barrier()
    assert again.frequencies == [] and not list(folder.glob("modes*"))
    comm.barrier()


# --- mistakes ------------------------------------------------------------------------------------


@mpi
def test_more_modes_than_degrees_of_freedom(comm, folder):
    all_of_it = {"mesh": Geometry(source="cube"), "cells": 1, "element": "Q1"}
    assert len(solve(**all_of_it, count=12).frequencies) == 12
    with pytest.raises(BadInput, match=r"count = 13: there are only 12 free"):
        solve(**all_of_it, count=13, out=folder)
    assert not (folder / "run.json").exists()


@mpi
def test_without_slepc(comm, monkeypatch):
    monkeypatch.setitem(sys.modules, "slepc4py", None)
    monkeypatch.delitem(sys.modules, "slepc4py.SLEPc", raising=False)
    with pytest.raises(BadInput, match=r"modes need slepc4py .*install python3-slepc4py-real"):
        solve(cells=3)


@mpi
def test_no_convergence_is_told(comm, folder):
    few = {"modes_eps_max_it": 1, "modes_eps_ncv": 7, "modes_eps_tol": 1e-15}
    with pytest.raises(BadInput, match=r"SLEPc found \d+ of 6 eigenvalues .*-snh_modes_eps_max_it"):
        solve(cells=3, petsc=few, out=folder)
    comm.barrier()
    kept = json.loads((folder / "run.json").read_text())
    assert kept["status"].startswith("failed: modes: SLEPc found") and not kept["converged"]
    assert kept["steps"][0]["converged"] and "modes" not in kept
    comm.barrier()


def test_forces_without_an_energy_have_no_frequencies():
    with pytest.raises(BadInput, match="modes: expected equilibria of an energy, not a load or a"):
        solve(cells=3, material="filtered_neo_hookean")


@pytest.mark.one_debian
def test_a_scene_without_modes_does_not_load_slepc():
    code = (
        "import fem_snh, sys; fem_snh.run('pull', cells=1, steps=1, progress=False); "
        "assert not [m for m in sys.modules if m.startswith('slepc4py')]"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_materials_without_a_density_have_that_of_water_for_modes():
    given, default = (
        solve("twist", cells=2, steps=1, angle=0.1, modes={"count": 2} | density).record["modes"]
        for density in ({"density": 4000.0}, {})
    )
    assert (given["density"], default["density"]) == (4000, 1000)
    halved = np.array(default["frequencies"]) / 2
    assert given["frequencies"] == pytest.approx(halved, rel=1e-9)
