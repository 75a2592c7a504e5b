"""Pictures of obstacles: their surfaces, poses and movies."""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

import matplotlib.image
import numpy as np
import pytest
from contact_scenes import slide
from picture_runs import bad, record, write_record, write_run
from running import record as read_record
from running import solve

from fem_snh.viewing import render
from fem_snh.viewing.render.surfaces import Obstacles
from fem_snh.viewing.stored_run import obstacle_poses

REST = np.eye(3, 4).tolist()
BALL = {"shape": {"sphere": {"center": [0, 0, 1.5], "radius": 0.5}}, "pose": REST}


@pytest.mark.parametrize(
    "shape, area",
    [
        ({"polygon": {"points": [[0, 0], [1, 0], [1, 1], [0.5, 0.2], [0, 1]]}}, 0.6),
        ({"box": {"center": [0, 0, 0], "size": [0.6, 0.4, 9], "rotation": [0, 0, 0.3]}}, 0.24),
        ({"sphere": {"center": [0, 0, 0], "radius": 0.5}}, np.pi / 4),
        ({"plane": {"point": [0, 0, 0], "normal": [0, 1, 0]}}, 2.2 * 1.3),
    ],
    ids=lambda shape: next(iter(shape)) if isinstance(shape, dict) else "",
)  # fmt: skip
def test_obstacles_of_a_flat_picture_are_filled_sections(shape, area):
    """Their sides are not seen along z; half of the picture is 1.1 wide and 1.3 high."""
    pose = np.eye(3, 4)
    pose[:2, 3] = 0.1, 0.25
    made = {"shape": shape, "loads": [0, 1], "poses": [pose.tolist()] * 2}
    bounds = np.array([[-0.5, -0.55, 0], [0.7, 1.05, 0]])  # 0.6 and 0.8 on each side of (0.1, 0.25)
    ((_, section),) = Obstacles([made], flat=True).at(1.0, bounds)
    assert section.area == pytest.approx(area, rel=0.01)
    assert not np.asarray(section.points)[:, 2].any()


def test_poses_of_a_record(tmp_path):
    rows = {0.5: np.eye(3, 4, 1).tolist(), 1.0: np.eye(3, 4, 2).tolist()}
    foot = {"shape": {"surface": "a.stl"}, "pose": REST}
    content = record(obstacles={"ball": BALL, "foot": foot})
    for step in content["steps"]:
        step["obstacles"] = {name: {"pose": rows[step["load"]]} for name in ("ball", "foot")}
    ball, foot = obstacle_poses(content, tmp_path)
    assert (ball["loads"], ball["poses"]) == ([0.0, 0.5, 1.0], [REST, *rows.values()])
    assert foot["shape"] == {"surface": str(tmp_path / "a.stl")}
    in_time = content | {"time": {"duration": 2.0}}
    in_time["steps"] = [{**step, "time": 2 * step["load"]} for step in content["steps"]]
    assert obstacle_poses(in_time, tmp_path)[0]["loads"] == [0.0, 1.0, 2.0]
    content["steps"] = []
    bounds = np.array([[-1, -1, 0], [1, 1, 2]])
    assert Obstacles(obstacle_poses(content, tmp_path)[:1]).at(0.0, bounds)
    assert obstacle_poses(record(), tmp_path) == []


def test_a_surface_of_an_obj_file_is_drawn(tmp_path):
    corners = [(x, y, z) for x in (0, 1) for y in (0, 1) for z in (1, 2)]
    faces = "1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4"
    lines = [*("v {} {} {}".format(*corner) for corner in corners), *(f"f {f}" for f in faces)]
    (tmp_path / "press.obj").write_text("\n".join(lines))
    scene = slide(shape=None, surface=tmp_path / "press.obj", friction=0.0)
    solve(scene, out=tmp_path / "out", steps=1)
    poses = obstacle_poses(read_record(tmp_path / "out"), tmp_path / "out")
    ((_, drawn),) = Obstacles(poses).at(1.0, np.array([[0, 0, 0], [1, 1, 2]]))
    assert drawn.bounds == pytest.approx([0.06, 1.06, 0, 1, 0.9, 1.9], abs=1e-6)


def coloured(path: Path) -> int:
    """Return the number of pixels that are not grey, which show the body."""
    picture = matplotlib.image.imread(path)[..., :3]
    return int((np.ptp(picture, axis=2) > 0.2).sum())


@pytest.mark.one_debian
def test_a_picture_and_a_missing_surface(comm: MPI.Intracomm, folder: Path):
    write_run(comm, folder, "Q1")
    plain = render.main(folder, folder / "plain.png", [1.0], "energy_density")
    content = record(obstacles={"ball": BALL})
    for step in content["steps"]:
        step["obstacles"] = {"ball": {"pose": REST}}
    write_record(folder, content)
    drawn = render.main(folder, folder / "ball.png", [1.0], "energy_density")
    # The view is of the lower part of the ball, too, and so the body is smaller.
    assert 0.3 < coloured(drawn) / coloured(plain) < 0.8
    content["obstacles"]["ball"]["shape"] = {"surface": "ball.stl"}
    write_record(folder, content)
    assert "ball.stl: cannot be read" in bad(render.main, folder, folder / "ball.png", [1.0])
