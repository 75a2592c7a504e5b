"""obstacles.pvd: the surfaces of moving obstacles for ParaView."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import pyvista as pv
from contact_scenes import slide
from interrupted_runs import cut
from running import solve

from fem_snh.geometry.shapes import Box, Capsule, Cylinder, Polygon, Sphere, from_record
from fem_snh.geometry.shapes.triangles import surface_triangles

ENDS: Any = ((0.1, 0.2, 0.3), (0.9, 0.5, 0.6))
LENGTH = np.linalg.norm(np.subtract(*ENDS))
R = 0.4
#: Shape, its volume; a polygon of 48 edges has 0.3 % less than a circle, and it turns.
SHAPES = [
    (Sphere((1, 2, 3), R), 4 / 3 * np.pi * R**3),
    (Capsule(*ENDS, R), np.pi * R**2 * (LENGTH + 4 / 3 * R)),
    (Cylinder(*ENDS, R), np.pi * R**2 * LENGTH),
    (Box((0, 1, 0), (1, 2, 3), (0.3, -0.5, 0.8)), 6.0),
]
#: Another two obstacles of a plate that slides: one turns, one has no parametrisation.
BALLS = [{"sphere": {"center": [x, 0.5, -2.0], "radius": 0.3}} for x in (0.3, 0.7)]
OTHERS: list[dict[str, Any]] = [
    {"name": "box", "shape": {"box": {"center": [0, 0, -2], "size": [1, 0.5, 0.2]}},
     "rotate": {"axis": [1, 1, 0], "angle": 2.0}, "translate": [0, 0, 0.5]},
    {"name": "balls", "shape": {"smooth_union": {"shapes": BALLS, "blend": 0.05}}},
]  # fmt: skip


@pytest.mark.parametrize(("shape", "volume"), SHAPES, ids=lambda s: type(s).__name__)
def test_triangles_are_closed_and_on_the_shape(shape: Any, volume: float) -> None:
    """Their points are at distance 0; the volume inside is that of the shape."""
    points, triangles = surface_triangles(shape, np.zeros(3), 2.0)
    assert set(triangles.ravel()) <= set(range(len(points)))
    used = points[np.unique(triangles)]
    assert np.abs(shape.distance(used)).max() < 1e-12
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    assert np.einsum("ni,ni->", a, np.cross(b, c)) / 6 == pytest.approx(volume, rel=0.01)


@pytest.mark.parametrize("step", [1, -1])
def test_the_sides_of_a_polygon_face_outwards(step: int) -> None:
    """Whichever way its corners go: the cones from the origin to the sides are 2/3 of the prism."""
    shape = Polygon(((0.0, 0.0), (2.0, 0.0), (2.0, 1.0), (0.5, 1.5))[::step])
    points, triangles = surface_triangles(shape, np.zeros(3), 3.0)
    a, b, c = np.moveaxis(points[triangles], 1, 0)
    cones = np.einsum("ni,ni->", a, np.cross(b, c)) / 6
    assert cones == pytest.approx(2 / 3 * 2.25 * 6.0, rel=1e-12)


@pytest.mark.mpi
def test_the_series_of_a_run(comm: MPI.Intracomm, folder: Any) -> None:
    """At each time the points are on the obstacles where run.json has them; a resumed run adds."""
    scene = slide()
    scene = scene.model_validate({**dict(scene), "obstacle": [*scene.obstacle, *OTHERS]})
    with cut(2):
        solve(scene, comm, out=folder)
    result = solve(scene, comm, out=folder, resume=True)
    comm.barrier()
    if comm.rank:
        return
    reader: Any = pv.get_reader(str(folder / "obstacles.pvd"))
    assert reader.time_values == pv.get_reader(str(folder / "fields.pvd")).time_values
    about = result.record["obstacles"]
    for step, time in zip(result.steps, reader.time_values[1:], strict=True):
        reader.set_active_time_value(time)
        grid = reader.read()[0]
        for number, (name, obstacle) in enumerate(about.items()):
            part = grid.extract_cells(np.flatnonzero(grid["obstacle"] == number))
            pose = np.array(step["obstacles"][name]["pose"])
            X = (np.asarray(part.points) - pose[:, 3]) @ pose[:, :3]
            tolerance = 2e-3 if name == "balls" else 1e-12
            assert np.abs(from_record(obstacle["shape"]).distance(X)).max() < tolerance
