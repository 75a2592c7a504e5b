"""Section planes, cameras, hidden solids and one-sided scales of pictures."""

from __future__ import annotations

import math
from dataclasses import replace

from mpi4py import MPI

import numpy as np
import pytest
from picture_runs import bad, record, write_record, write_run

from fem_snh.viewing import render
from fem_snh.viewing.render import drawing, surfaces
from fem_snh.viewing.stored_run import ViewOptions, obstacle_poses, view_options


def grid_of(folder, element="Q1", field="J", load=1.0):
    """Return a state of a new run."""
    write_run(MPI.COMM_SELF, folder, element)
    files = [str(file) for file in render.stored_loads(folder / "fields.pvd")[load]]
    return surfaces.read_grid(files, field)


@pytest.mark.parametrize("element, layers", [("Q1", 3), ("Q2", 6), ("P1", 3), ("P2", 6)])
def test_a_section_closes_half_of_the_body(folder, element, layers):
    """The area of a horizontal section of the twisted cube is that of interpolated squares.

    Between two layers of nodes, which are squares turned by an angle a to each other, the square
    is (1 - t) + t exp(i a) times the lower one.
    """
    plane = view_options(clip="0,0,1@0,0,0.45")
    half = surfaces.body_of(grid_of(folder, element, load=0.5), "J", plane)
    assert half.surface.bounds[4:] == pytest.approx((0, 0.45))
    surface = half.surface.triangulate()
    triangles = surface.points[surface.regular_faces].astype(float)
    cut = triangles[np.isclose(triangles[..., 2], 0.45).all(axis=1)]
    normals = np.cross(cut[:, 1] - cut[:, 0], cut[:, 2] - cut[:, 0])
    t = 0.45 * layers % 1
    area = 1 - 2 * t * (1 - t) * (1 - math.cos(math.pi / 2 / layers))
    assert np.linalg.norm(normals, axis=1).sum() / 2 == pytest.approx(area)
    assert len(half.values) == half.surface.n_cells
    assert half.edges.bounds[5] == pytest.approx(0.45, abs=1e-6)


def test_a_section_has_the_values_of_the_inside(folder):
    """The smallest J of a cell inside the body is seen in a section only."""
    grid = grid_of(folder)
    middle = grid.find_containing_cell([0.5, 0.5, 0.5])
    grid.cell_data["J"][:] = 1.0
    grid.cell_data["J"][middle] = 0.25
    assert surfaces.body_of(grid, "J").values.min() == 1
    item = surfaces.body_of(grid, "J", view_options(clip="x"))
    assert item.values.min() == 0.25
    # The default plane goes through the centre of the body at rest.
    assert item.surface.bounds[1] == pytest.approx(0.5)


def test_values_that_the_colours_leave_out_are_named(folder):
    """One cell inside has the largest value: neither the surface nor the percentiles show it."""
    grid = grid_of(folder, field="energy_density")
    middle, corner = (grid.find_containing_cell([x, x, x]) for x in (0.5, 0.1))
    values = grid.cell_data["energy_density"]
    values[:] = np.linspace(3, 5, len(values))
    values[middle], values[corner] = 40.0, 20.0
    item = surfaces.body_of(grid, "energy_density")
    panels = [render.Panel([], "load 1  ·  volume 0 %", 1.0)]
    job = render.Job("energy_density", "", panels, folder)
    drawn = drawing.Drawing(job, [item])
    assert drawn.norm.vmax < 21
    assert drawn.label.endswith("values from 3.08 to 40, the colours end before")
    line = drawn.extremes_line
    assert line.startswith("energy density [Pa]: from 3.077 at (")
    assert line.endswith("to 40 at (0.5, 0.5, 0.5), load 1")
    wide = drawing.Drawing(replace(job, view=view_options(limits="-1,50")), [item])
    assert (wide.norm.vmin, wide.norm.vmax, wide.extend) == (-1, 50, "neither")
    assert wide.label == "energy density [Pa]"


def test_a_plane_beside_the_body(folder):
    write_run(MPI.COMM_SELF, folder, "Q1")
    message = bad(lambda: render.main(folder, view=view_options(clip="x@-3")))
    assert message.startswith("--clip: nothing of the body is behind the plane")


def test_directions_and_points_of_the_command_line():
    options = view_options("0,0,2@0,0,0.2", "-y@1,2,3", 2.0, ["ball"])
    assert options == ViewOptions((0, 0, 1), (0, 0, 0.2), (0, -1, 0), (1, 2, 3), 2, ("ball",))
    assert view_options("0,3,4@5").clip_point == pytest.approx((0, 3, 4))
    for clip in ("", "w", "1,2", "0,0,0", "nan,0,1", "x@", "x@1,2", "x@inf"):
        assert bad(view_options, clip).startswith(f"--clip = '{clip}': expected a direction")
    assert view_options(limits="-0.5,2").limits == (-0.5, 2)
    for limits in ("", "1", "2,1", "1,1", "0,nan", "0,inf", "0,1,2"):
        found = bad(lambda text=limits: view_options(limits=text))
        assert found.startswith(f"--range = '{limits}': expected two numbers")
    for zoom in (0.0, -1.0, math.inf, math.nan):
        assert bad(view_options, None, None, zoom).startswith("--zoom = ")


def test_the_camera_looks_from_its_direction(folder):
    item = surfaces.body_of(grid_of(folder, load=0.0), "J")
    seen = drawing.view([item], options=view_options(camera="x@0.1,0.2,0.3", zoom=2.0))
    assert seen.centre == pytest.approx([0.1, 0.2, 0.3])
    assert seen.towards == pytest.approx([1, 0, 0]) and seen.up == pytest.approx([0, 0, 1])
    assert (seen.width, seen.height) == pytest.approx((0.52, 0.52))
    assert drawing.view([item], options=view_options(camera="-z")).up == pytest.approx([0, 1, 0])


def test_hidden_solids(folder):
    write_run(MPI.COMM_SELF, folder, "Q1")
    pose = np.eye(3, 4).tolist()
    ball = {"shape": {"sphere": {"center": [0, 0, 2], "radius": 1}}, "pose": pose}
    content = record(obstacles={"ball": ball}, bones={"rod": ball})
    for step in content["steps"]:
        step |= {"obstacles": {"ball": {"pose": pose}}, "bones": {"rod": {"pose": pose}}}
    write_record(folder, content)
    (bone,) = obstacle_poses(content, folder, ("ball",))
    assert bone["kind"] == "bones"
    run = render.StoredRun(folder, "J", view_options(hide=["ball", "rod"]))
    assert run.panel(1.0).obstacles == []
    message = bad(lambda: render.main(folder, view=view_options(hide=["bal"])))
    assert message.startswith("--hide = 'bal': expected one of ball, rod")


@pytest.mark.parametrize(
    "field", ["energy_density", "von_mises", "contact_pressure", "displacement", "cauchy_stress"]
)
def test_scales_of_what_cannot_be_negative_start_at_zero(field):
    cmap, norm, extend = drawing.colours(field, np.linspace(3, 5, 500))
    assert (cmap, norm.vmin) == ("viridis", 0)
    assert norm.vmax == pytest.approx(4.98) and extend == "max"
    assert drawing.colours("cauchy_stress.xy", np.linspace(3, 5, 500))[1].vmin > 3
    contact = np.append(np.full(499, 2.0), -1e-16)  # by a projection
    assert drawing.colours("contact_pressure", contact)[2] == "neither"
