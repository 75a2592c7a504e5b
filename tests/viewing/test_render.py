"""Pictures of bodies, fields and modes: what dolfinx wrote is drawn; mistakes are one line."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import matplotlib.image
import numpy as np
import pytest
from dolfinx_programs import unit_cube
from picture_runs import CELLS, bad, nodal_arrays, record, write_record, write_run
from running import solve

from fem_snh import _dolfinx
from fem_snh.errors import BadInput, on_root
from fem_snh.runs.output.fields import GridSeries
from fem_snh.viewing import render
from fem_snh.viewing.render import drawing, surfaces
from fem_snh.viewing.stored_run import written_fields


def state_files(folder: Path, load: float = 1.0, series: str = "fields.pvd") -> list[str]:
    return [str(file) for file in render.stored_loads(folder / series)[load]]


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("element, cells", [("Q1", 27), ("Q2", 27), ("P1", 162), ("P2", 162)])
def test_fields_are_read_whole_and_once(comm, folder, element, cells):
    write_run(comm, folder, element)
    assert sorted(render.stored_loads(folder / "fields.pvd")) == [0.0, 0.5, 1.0]
    grid = surfaces.read_grid(state_files(folder), "J")
    assert grid.n_cells == cells == len(grid["J"])
    assert grid.n_points == (CELLS * int(element[1]) + 1) ** 3
    top = np.isclose(grid.points[:, 2], 1)
    a, b = (grid.points[top, :2] - 0.5).T
    assert np.allclose(grid["displacement"][top, :2].T, [-2 * a, -2 * b], atol=1e-12)


@pytest.mark.mpi
@pytest.mark.parametrize("element, faces, edges", [("Q1", 54, 108), ("P2", 108, 162)])
def test_surface_is_closed_and_follows_the_curved_cells(comm, folder, element, faces, edges):
    write_run(comm, folder, element)
    files = state_files(folder, 0.5)
    item = surfaces.body(files, "J")
    assert item.surface.n_open_edges == 0
    assert surfaces.boundary(surfaces.read_grid(files, "J"), 0).n_cells == faces
    # each element edge is cut in as many pieces as the faces are
    pieces = item.edges.n_cells / edges
    assert pieces in (2, 4, 8)
    assert len(item.values) == item.surface.n_cells
    # the outline at rest is that of the cube: 12 edges of length 1
    rest = item.ghost.compute_cell_sizes(length=True, area=False, volume=False)
    assert sum(rest["Length"]) == pytest.approx(12)


@pytest.mark.mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_render_draws_every_load(comm, folder, element):
    write_run(comm, folder, element)
    out = on_root(comm, render.main, folder, None, None)
    assert out == folder / "J.png"
    image = matplotlib.image.imread(out)
    assert image.shape[1] == 1600
    assert out.stat().st_size < 600_000
    body = np.ptp(image[..., :3], axis=2) + (image[..., 0] < 0.9) > 0
    for half in (body[200:-200, :800], body[200:-200, 800:]):  # two panels
        assert half.mean() > 0.2


@pytest.mark.one_debian
def test_two_dimensions_are_drawn_in_their_plane(tmp_path):
    """The camera looks along z, with y upwards; half of a section of a cylinder fills the picture.

    Its radius is 1/2, its length 1.
    """
    keys = {"stretch": 1.2, "steps": 1, "element": "Q2", "nu": 0.3, "kinematics": "axisymmetric"}
    solve("stretch", cells=4, out=tmp_path, **keys)
    item = surfaces.body(state_files(tmp_path), "J")
    where = drawing.view([item])
    assert where.towards == pytest.approx([0, 0, 1])
    assert (where.width, where.height) == pytest.approx((1.04 * 0.5, 1.04 * 1.2))
    assert item.edges is not None
    assert render.main(tmp_path, tmp_path / "flat.png").is_file()


@pytest.fixture(scope="module")
def bushing(tmp_path_factory) -> Path:
    """The section of a bushing whose inner sleeve, of radius 10, is turned by 0.5 rad."""
    out = tmp_path_factory.mktemp("bushing")
    solve("bushing", cells=1, steps=2, axial=0.0, error=True, out=out)
    return out


def test_torsion_keeps_the_radii_of_a_section_in_its_plane(bushing):
    points = surfaces.body(state_files(bushing), "J").surface.points
    assert not points[:, 2].any()
    assert (points[:, 0].min(), points[:, 0].max()) == pytest.approx((10, 20), rel=1e-6)


@pytest.mark.one_debian
def test_an_error_is_drawn_where_it_is_known(bushing):
    """At the last load: another has none."""
    pictures = [
        render.main(bushing, bushing / f"{loads}.png", loads=loads, field="error_inner_moment_y")
        for loads in (None, [1.0], [0.5, 1.0])
    ]
    default, last, both = (matplotlib.image.imread(picture) for picture in pictures)
    assert np.array_equal(default, last) and not np.array_equal(default, both)


def write_modes(comm: MPI.Intracomm, folder: Path, frequencies: list[float]) -> Path:
    """A run folder with modes of a sheared cube: displacements that grow with their number."""
    domain = unit_cube(comm, CELLS)
    V = _dolfinx.function_space(domain, 1, (3,))
    u, mode = _dolfinx.function(V, "displacement"), _dolfinx.function(V, "mode")
    u.interpolate(lambda x: np.array([0.5 * x[2], 0 * x[0], 0 * x[0]]))
    file = GridSeries(folder / "modes.pvd", V)
    for number in range(1, len(frequencies) + 1):
        mode.interpolate(lambda x, n=number: np.array([0 * x[0], n * x[2], 0 * x[0]]))
        file.write(float(number), nodal_arrays([u, mode]))
    eigenmodes = {"density": 1.0, "frequencies": frequencies, "residuals": [0.0] * len(frequencies)}
    on_root(comm, write_record, folder, record(modes=eigenmodes))
    comm.barrier()
    return folder


@pytest.mark.mpi
def test_render_modes(comm, folder):
    write_modes(comm, folder, [0.0, 1e-9, 3.0, 4.0])
    out = on_root(comm, lambda: render.main(folder, modes=True))
    assert out == folder / "modes.png"
    image = matplotlib.image.imread(out)
    body = np.ptp(image[..., :3], axis=2) > 0.1
    for half in (body[200:-200, :800], body[200:-200, 800:]):  # those that deform the body
        assert half.mean() > 0.2


def test_modes_are_exaggerated_alike_about_the_state_they_are_of(comm, folder):
    write_modes(comm, folder, [1.0, 2.0])
    for files in render.stored_loads(folder / "modes.pvd").values():
        item = surfaces.body([str(f) for f in files], "mode")
        rest, moved = item.rest.bounds, item.surface.bounds
        assert rest[:2] == pytest.approx((0, 1.5)) and rest[2:4] == pytest.approx((0, 1))
        diagonal = np.sqrt(1.5**2 + 1 + 1)
        assert moved[3] == pytest.approx(1 + surfaces._EXAGGERATION * diagonal)
        assert (item.values.min(), item.values.max()) == pytest.approx((0, 1))
    assert drawing.colours("mode", np.array([0.1, 0.9]))[1].vmax == 1


def test_colours_of_J_are_centred_at_one_and_robust():
    values = np.concatenate([np.linspace(0.95, 1.02, 1000), [40.0]])
    cmap, norm, extend = drawing.colours("J", values)
    assert (cmap, norm.vmin, norm.vmax, extend) == ("coolwarm", 0.95, 1.05, "max")
    assert drawing.colours("J", np.array([-9.0, 1.0]))[1].vmin == 0
    assert drawing.colours("energy_density", np.zeros(9))[0] == "viridis"
    with pytest.raises(BadInput, match="no finite value"):
        drawing.colours("J", np.array([np.nan]))


@pytest.mark.one_debian
def test_render_bad_files(comm, folder):
    twisted = write_run(comm, folder, "Q1")
    assert "did you mean 'displacement'" in bad(render.main, twisted, None, None, "displacment")
    assert "stored are 0, 0.5, 1" in bad(render.main, twisted, None, [0.3])
    blocked = twisted / "run.json" / "x.png"
    assert "cannot write" in bad(render.main, twisted, blocked, [1.0])
    piece = render.stored_loads(twisted / "fields.pvd")[1.0][0]
    piece.write_bytes(piece.read_bytes()[:300])
    assert piece.name in bad(render.main, twisted, None, [1.0])
    piece.unlink()
    assert f"{piece}: missing" in bad(render.main, twisted, None, [1.0])
    (twisted / "fields.pvd").write_text("<VTKFile>")
    assert "fields.pvd" in bad(render.main, twisted)
    (twisted / "fields.pvd").unlink()
    assert "fields.pvd" in bad(render.main, twisted)


# --- the fields that a run has written ----------------------------------------------------------


@pytest.fixture(scope="module")
def stressed(tmp_path_factory):
    """A run with some fields at cells and at nodes."""
    folder = tmp_path_factory.mktemp("run")
    names = ["von_mises", "cauchy_stress", "principal_stresses", "reaction_force"]
    solve("twist", cells=2, steps=1, angle=0.8, fields=names, out=folder)
    return folder


def values(folder, field):
    files = state_files(folder)
    return surfaces.read_grid(files, field)[field], surfaces.body(files, field).values


def test_the_fields_of_a_run_are_those_of_its_files(stressed):
    assert written_fields(stressed / "fields.pvd") == [
        "J", "cauchy_stress", "displacement", "energy_density", "min_J", "min_eigenvalue",
        "principal_stresses", "reaction_force", "von_mises",
    ]  # fmt: skip


def test_components_and_magnitudes_are_drawn(stressed):
    tensor, magnitude = values(stressed, "cauchy_stress")
    xy, _ = values(stressed, "cauchy_stress.xy")
    assert tensor.shape == (8, 9) and (xy == tensor[:, 1]).all()
    frobenius = np.sqrt((tensor**2).sum(axis=1))
    assert set(magnitude.round(12)) <= set(frobenius.round(12))
    largest, _ = values(stressed, "principal_stresses.1")
    smallest, _ = values(stressed, "principal_stresses.3")
    assert (largest > smallest).all()
    up, drawn = values(stressed, "displacement.z")
    assert len(up) == 27 and drawn.min() >= up.min() - 1e-12
    force, _ = values(stressed, "reaction_force.x")
    assert abs(force).max() > 0.01


def test_mistakes_in_fields(stressed):
    def error_message(field):
        return bad(render.main, stressed, None, None, field)

    for field in ("von_mses", "pk1_stress", "pk1_stress.xy"):
        message = error_message(field)
        assert message.startswith(f"field = '{field}': expected one of J, cauchy_stress, ")
    assert "did you mean 'von_mises'" in error_message("von_mses")
    assert "a run with --set fields=pk1_stress writes it" in error_message("pk1_stress.xy")
    assert error_message("cauchy_stress.q") == (
        "field = 'cauchy_stress.q': expected a component of cauchy_stress: "
        "xx, xy, xz, yx, yy, yz, zx, zy, zz"
    )
    assert error_message("von_mises.x") == "field = 'von_mises.x': expected 'von_mises', a scalar"
