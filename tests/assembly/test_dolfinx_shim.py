"""Output through the shim: series that readers agree with."""

from __future__ import annotations

import numpy as np
import pytest
from polynomials import ELEMENTS, linear, quadratic

from fem_snh import _dolfinx
from fem_snh.mesh import mesh
from fem_snh.runs.output.fields import GridSeries
from fem_snh.runs.output.vtu import DataArray

mpi = pytest.mark.mpi


@pytest.fixture(params=ELEMENTS, ids=["Q1", "P1", "Q2", "P2"])
def space(request, comm):
    """A vector space on the cylinder, whose cells are no cubes."""
    cell, degree = request.param
    m = mesh.generate(comm, "cylinder", cell, cells=4)
    return _dolfinx.function_space(m.domain, degree, (3,))


@pytest.mark.one_debian("ranks")
@mpi
def test_pvd_files_read_back_in_pyvista(comm, folder, space):
    import pyvista

    domain, degree = space.mesh, _dolfinx.degree(space)
    field = quadratic if degree == 2 else linear
    u = _dolfinx.function(space, "displacement")
    middles = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)].mean(axis=1)
    path = folder / "fields.pvd"
    series = GridSeries(path, space)
    for t in (0.0, 0.5, 0.7, 1.0):
        u.interpolate(lambda x, t=t: t * field(x))
        cells = [
            DataArray("energy_density", t + middles[:, 1]),
            DataArray("whole", np.arange(len(middles), dtype=np.int32)),
            DataArray("stress", middles[:, :, None] * [1.0, 2.0], ("a", "b", "c", "d", "e", "f")),
        ]
        series.write(t, [DataArray("displacement", u.x.array.reshape(-1, 3))], cells)
        comm.barrier()  # the file is complete after every write
        reader = pyvista.get_reader(str(path))
        assert reader.time_values == [s for s in (0.0, 0.5) if s < t] + [t]
        if t == 0.7:  # another series goes on, up to what it is told to keep
            series = GridSeries(path, space, 0.6)
            assert series.times == [0.0, 0.5]
        comm.barrier()
    assert not [file for file in folder.iterdir() if file.name.startswith(".")]
    reader.set_active_time_value(1.0)
    grid = reader.read().combine()
    assert grid.n_cells == comm.allreduce(_dolfinx.num_owned(domain))  # each once
    assert grid.point_data["displacement"] == pytest.approx(field(grid.points.T).T, abs=1e-12)
    middle = grid.cell_centers().points
    assert grid.cell_data["energy_density"] == pytest.approx(1 + middle[:, 1], abs=1e-12)
    assert grid.cell_data["whole"].dtype == np.int32
    stress = (middle[:, :, None] * [1.0, 2.0]).reshape(-1, 6)
    assert grid.cell_data["stress"] == pytest.approx(stress, abs=1e-12)
    # Inside the cells, where a wrong order of the nodes would show.
    inside = pyvista.PolyData(np.random.default_rng(0).uniform(0.2, 0.3, (50, 3)))
    sampled = inside.sample(grid)
    assert sampled["displacement"] == pytest.approx(field(inside.points.T).T, abs=1e-6)
