"""The shim gives the same on every dolfinx: layouts, assembly, output that readers agree with."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
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


def gathered(comm, array):
    return np.concatenate(comm.allgather(array))


@pytest.mark.one_debian("ranks")
@mpi
def test_own_loop_over_cells_gives_dolfinx_integrals(comm, space):
    """A field's gradient by node_dofs, tabulate and the geometry's twins, against a form."""
    field = quadratic if _dolfinx.degree(space) == 2 else linear
    u = _dolfinx.function(space, "u")
    u.interpolate(field)
    domain = space.mesh
    points, weights = _dolfinx.quadrature(_dolfinx.cell_name(domain), 6)
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)]
    jacobian = np.einsum("cni,pnj->cpij", x, _dolfinx.tabulate_geometry(domain, points))
    gradient = np.einsum(
        "pnj,cpji->cpni", _dolfinx.tabulate(space, points), np.linalg.inv(jacobian)
    )
    with _dolfinx.petsc_vec(u).localForm() as local:
        values = local.array_r.reshape(-1, 3)[_dolfinx.node_dofs(space)]
    assert sum(_dolfinx.num_nodes(space)) * 3 == u.x.array.size
    grad = np.einsum("cni,cpnj->cpij", values, gradient)
    volumes = abs(np.linalg.det(jacobian)) * weights
    weight = np.random.default_rng(1).normal(size=(3, 3))
    own = comm.allreduce(float(np.einsum("cpij,ij,cp->", grad, weight, volumes)))
    integrand = ufl.inner(ufl.grad(u), ufl.as_matrix(weight.tolist()))
    form = _dolfinx.form(integrand * ufl.dx(metadata={"quadrature_degree": 6}))
    assert own == pytest.approx(_dolfinx.assemble_scalar(form), rel=1e-12)


@mpi
def test_nodes_are_numbered_once_over_the_ranks(comm, space):
    owned, ghosts = _dolfinx.num_nodes(space)
    numbers = _dolfinx.local_to_global(space)
    assert (numbers.dtype, len(numbers)) == (np.int64, owned + ghosts)
    total = space.dofmap.index_map.size_global
    assert np.array_equal(np.sort(gathered(comm, numbers[:owned])), np.arange(total))
    dofs = _dolfinx.node_dofs(space)
    assert dofs.dtype == np.int32 and len(dofs) == len(_dolfinx.geometry_dofs(space.mesh))
    assert comm.allreduce(len(dofs)) == comm.allreduce(_dolfinx.num_owned(space.mesh))
    assert np.array_equal(np.unique(dofs), np.arange(owned + ghosts))


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
