"""Tetrahedra that fill shapes and closed surfaces."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import pyvista as pv
from running import solve

from fem_snh import scenes
from fem_snh.geometry.shapes import Capsule, SmoothUnion, Sphere
from fem_snh.mesh import lattice, mesh, mesh_checks

COMM = MPI.COMM_WORLD
BALL = Sphere((0.1, 0.2, 0.3), 0.5)
CLUB = SmoothUnion((Capsule((0, 0, 0), (1, 0, 0), 0.2), Sphere((1, 0, 0), 0.3)), 0.02)


@pytest.mark.mpi
@pytest.mark.parametrize("shape, quality", [(BALL, 0.1), (CLUB, 0.05)], ids=["ball", "club"])
def test_shapes(shape, quality):
    body = lattice.create_tetrahedra(COMM, lambda: shape, 0.15)
    assert [g.label for g in body.groups] == ["surface:boundary", "volume:body"]
    worst = COMM.allreduce(mesh_checks.scaled_jacobian(body.domain).min(), op=MPI.MIN)
    assert worst > quality
    if shape is BALL:
        # Triangles of edge e in a sphere: the missing volume is about (e/r)^2/3 of it.
        assert mesh.volume(body.domain) == pytest.approx(np.pi / 6, rel=0.5 * (0.15 / 0.5) ** 2)


def test_a_file_in_a_scene(tmp_path):
    pv.Icosphere(radius=0.5, nsub=2).save(tmp_path / "ball.stl")
    scene = scenes.Scene(
        name="ball",
        mesh=scenes.Tetrahedra(surface=tmp_path / "ball.stl", size=0.2),
        element="P1",
        material=scenes.MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
        move=[scenes.Move(group="boundary", translate=(0.1, 0, 0))],
    )
    result = solve(scene, MPI.COMM_SELF)
    assert result.converged
    assert result.record["steps"][-1]["volume_ratio"] == pytest.approx(1, abs=1e-9)
