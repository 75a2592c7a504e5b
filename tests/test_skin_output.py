"""The skin in the output: skin.pvd, pictures and exports."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
import pyvista as pv
from running import solve

from fem_snh import export, render, scenes
from fem_snh.errors import BadInput, on_root

#: A ball that moves as a whole with a bone, while it is stretched along x by 20 %.
BALL = {"sphere": {"center": [0.1, 0.2, 0.3], "radius": 0.5}}
AFFINE = np.diag([1.2, 1.0, 1.0])
LOADS = (0.0, 0.5, 1.0)


def stretched(load: float) -> np.ndarray:
    """Return the affine of the bone at a load."""
    return np.column_stack([np.eye(3) + load * (AFFINE - np.eye(3)), [0, 0, 0.3 * load]])


@pytest.fixture
def folder(tmp_path_factory, comm=MPI.COMM_WORLD):
    """Return the folder of a run on all ranks, the same on each."""
    path = on_root(comm, lambda: tmp_path_factory.mktemp("skin"))
    scene = scenes.Scene(
        name="ball",
        mesh=scenes.Lattice(lattice=BALL, cell=0.24),
        element="Q1",
        steps=2,
        material=scenes.MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
        bone=[{"name": "all", "motion": stretched, "shape": {
            "sphere": {"center": [0, 0, 0], "radius": 9.0}}}],
        fields=["von_mises"],
    )  # fmt: skip
    solve(scene, comm, out=path / "run")
    return path / "run"


def moved(points: np.ndarray, load: float) -> np.ndarray:
    """Return where the bone takes points."""
    affine = stretched(load)
    return points @ affine[:, :3].T + affine[:, 3]


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
        assert np.abs(np.linalg.norm(X - [0.1, 0.2, 0.3], axis=1) - 0.5).max() < 0.01
        assert np.abs(X + u - moved(X, load)).max() < 1e-12
        assert np.allclose(grid["J"], 1 + 0.2 * load, rtol=1e-12)
        assert {"energy_density", "min_eigenvalue", "von_mises"} < set(grid.point_data.keys())


def test_pictures_and_exports_show_the_skin(folder, tmp_path):
    skin = pv.read(folder / "skin000002.vtu")
    assert render.main(folder, tmp_path / "a.png").stat().st_size > 10_000
    for load, path in zip(LOADS, export.main(folder, tmp_path / "a.obj"), strict=True):
        obj = pv.read(path)
        assert obj.n_cells == skin.n_cells and obj.n_points == skin.n_points
        centre = moved(np.array([[0.1, 0.2, 0.3]]), load)[0]
        assert obj.center_of_mass() == pytest.approx(centre, abs=0.03)
        assert obj.volume == pytest.approx((1 + 0.2 * load) * np.pi / 6, rel=0.05)
    (hdf,) = export.main(folder, tmp_path / "a.vtkhdf")
    assert pv.read(hdf).n_cells == skin.n_cells


@pytest.mark.parametrize("suffix", [".usda", ".usdc", ".usd"])
def test_usd(folder, tmp_path, suffix):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    (path,) = export.main(folder, tmp_path / f"a{suffix}")
    stage = Usd.Stage.Open(str(path))
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim())
    skin = pv.read(folder / "skin000002.vtu")
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0.0, 48.0)
    assert mesh.GetPointsAttr().GetTimeSamples() == [0.0, 24.0, 48.0]
    assert len(mesh.GetFaceVertexCountsAttr().Get()) == skin.n_cells
    rest = np.array(mesh.GetPointsAttr().Get(0.0))
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    a, b, c = (rest[faces[:, i]] for i in range(3))
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6 == pytest.approx(np.pi / 6, rel=0.05)
    for load in LOADS:
        time = Usd.TimeCode(48 * load)
        x = np.array(mesh.GetPointsAttr().Get(time))
        assert np.abs(x - moved(rest, load)).max() < 1e-6
        box = np.array(mesh.GetExtentAttr().Get(time))
        assert np.array_equal(box, [x.min(axis=0), x.max(axis=0)])
        assert np.array_equal(box, mesh.ComputeExtent(mesh.GetPointsAttr().Get(time)))
        J = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("J")
        assert J.GetInterpolation() == "vertex" and len(J.Get(time)) == len(x)
        assert np.allclose(J.Get(time), 1 + 0.2 * load)


def test_usd_without_the_package(folder, tmp_path, monkeypatch):
    from fem_snh.render import worker

    monkeypatch.setattr(worker, "find_spec", lambda name: None if name == "pxr" else object())
    message = r"a file .usd needs pxr: pip install 'fem_snh\[usd\]'"
    with pytest.raises(BadInput, match=message):
        export.main(folder, tmp_path / "a.usd")
