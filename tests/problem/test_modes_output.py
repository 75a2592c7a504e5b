"""Files of the modes, and errors that are found before the load steps."""

from __future__ import annotations

import csv

import pytest
from running import record, solve

mpi = pytest.mark.mpi


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_record_table_and_shapes(comm, folder, element):
    import pyvista

    setup = {"cells": 3, "count": 4, "aspect": 2.0, "element": element, "density": 500.0}
    result = solve("modes", **setup, out=folder)
    comm.barrier()
    modes = record(folder)["modes"]
    assert modes == result.record["modes"]
    assert modes["density"] == pytest.approx(500, rel=1e-12)
    assert modes["frequencies"] == result.frequencies
    assert len(modes["residuals"]) == 4 and max(modes["residuals"]) < 1e-9
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
    again = solve(cells=1, angle=0.1, out=folder, overwrite=True)
    comm.barrier()
    assert again.frequencies == [] and not list(folder.glob("modes*"))
    comm.barrier()
