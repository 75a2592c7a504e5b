"""The skin in the output: skin.pvd, pictures and exports."""

from __future__ import annotations

from itertools import product
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import pyvista as pv
from running import solve

from fem_snh import scenes
from fem_snh.errors import on_root
from fem_snh.viewing import export, render

#: A ball that moves as a whole with a bone, while it is stretched along x by 20 %.
CENTER, RADIUS = np.array([0.1, 0.2, 0.3]), 0.5
BALL = {"sphere": {"center": CENTER.tolist(), "radius": RADIUS}}
AFFINE = np.diag([1.2, 1.0, 1.0])
LOADS = (0.0, 0.5, 1.0)
#: Cells so small that those around a free node in the middle are full.
CELL = 0.16


def stretched(load: float) -> np.ndarray:
    """Return the affine of the bone at a load."""
    return np.column_stack([np.eye(3) + load * (AFFINE - np.eye(3)), [0, 0, 0.3 * load]])


def all_but(center: np.ndarray, half: float) -> list[dict[str, Any]]:
    """Return six bones of one motion around a cube, whose nodes are free and move along."""
    sides = []
    for axis, sign in product(range(3), (1, -1)):
        middle, size = center.copy(), 200 * half
        middle[axis] += sign * (half + size / 2)
        box = {"box": {"center": middle.tolist(), "size": [size] * 3}}
        sides.append({"name": f"{'xyz'[axis]}{sign}", "motion": stretched, "shape": box})
    return sides


@pytest.fixture
def folder(tmp_path_factory, comm=MPI.COMM_WORLD):
    """Return the folder of a run on all ranks, the same on each."""
    path = on_root(comm, lambda: tmp_path_factory.mktemp("skin"))
    solve(ball(), comm, out=path / "run")
    return path / "run"


def ball() -> scenes.Scene:
    """Return the scene of the ball."""
    return scenes.Scene(
        name="ball",
        mesh=scenes.Lattice(lattice=BALL, cell=CELL),
        element="Q1",
        steps=2,
        material=scenes.MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
        bone=all_but(CENTER, 0.51 * CELL),
        fields=["von_mises"],
    )  # fmt: skip


def moved(points: np.ndarray, load: float) -> np.ndarray:
    """Return where the bone takes points."""
    affine = stretched(load)
    return points @ affine[:, :3].T + affine[:, 3]


@pytest.mark.one_debian
@pytest.mark.mpi
def test_the_series_of_the_skin(folder):
    if MPI.COMM_WORLD.rank:
        return
    reader: Any = pv.get_reader(folder / "skin.pvd")
    assert tuple(reader.time_values) == LOADS
    for load in LOADS:
        reader.set_active_time_value(load)
        grid = reader.read()[0]
        X, u = np.asarray(grid.points), grid["displacement"]
        assert np.abs(np.linalg.norm(X - CENTER, axis=1) - RADIUS).max() < 0.01
        assert np.abs(X + u - moved(X, load)).max() < 1e-12
        assert np.allclose(grid["J"], 1 + 0.2 * load, rtol=1e-12)
        assert {"energy_density", "min_eigenvalue", "von_mises"} < set(grid.point_data.keys())


def test_pictures_and_exports_show_the_skin(folder, tmp_path):
    skin = pv.read(folder / "skin000002.vtu")
    assert render.main(folder, tmp_path / "a.png").stat().st_size > 10_000
    for load, path in zip(LOADS, export.main(folder, tmp_path / "a.obj"), strict=True):
        obj = pv.read(path)
        assert obj.n_cells == skin.n_cells and obj.n_points == skin.n_points
        centre = moved(CENTER[None], load)[0]
        assert obj.center_of_mass() == pytest.approx(centre, abs=0.03)
        assert obj.volume == pytest.approx((1 + 0.2 * load) * np.pi / 6, rel=0.05)
    (hdf,) = export.main(folder, tmp_path / "a.vtkhdf")
    assert pv.read(hdf).n_cells == skin.n_cells
