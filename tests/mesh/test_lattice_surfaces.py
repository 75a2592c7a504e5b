"""Lattices and tetrahedra of shapes and closed surfaces: volumes, skins and mistakes."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import pyvista as pv
from running import solve

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.geometry.shapes import Capsule, ClosedSurface, SmoothUnion, Sphere
from fem_snh.geometry.shapes.closed_surface import check_closed, enclosed_volume
from fem_snh.mesh import lattice, mesh, mesh_checks


def surface(made: pv.PolyData) -> ClosedSurface:
    """Return a surface of PyVista's."""
    made = made.triangulate().clean()
    return ClosedSurface(np.asarray(made.points, float), np.asarray(made.regular_faces, np.int64))


BALL = surface(pv.Icosphere(radius=0.5, nsub=3))
BOX = surface(pv.Box((0.0, 1.0, 0.0, 0.6, 0.0, 0.4)))
TORUS = surface(pv.ParametricTorus(ringradius=0.5, crosssectionradius=0.2))


@pytest.mark.parametrize("body", [BALL, BOX, TORUS], ids=["ball", "box", "torus"])
@pytest.mark.parametrize("cell", [0.17, 0.1])
def test_volume_and_skin(body, cell):
    data = lattice.lattice(body, cell)
    exact = enclosed_volume(body.points, body.triangles)
    assert data.fractions.sum() * cell**3 == pytest.approx(exact, rel=0.12 * cell)
    skin = data.skin
    check_closed(skin.points, skin.triangles.astype(np.int64), "skin")
    assert enclosed_volume(skin.points, skin.triangles) == pytest.approx(exact, rel=1e-12)
    xi = (skin.points - data.x[data.cells[skin.cells, 0]]) / cell
    assert xi.min() > -0.011 and xi.max() < 1.011
    edges = skin.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.linalg.norm(skin.points[edges[:, 0]] - skin.points[edges[:, 1]], axis=1).max() <= cell


def joined(first: ClosedSurface, second: ClosedSurface, sign: int = 1) -> ClosedSurface:
    """Return two surfaces as one; with sign -1 the second is a cavity in the first."""
    points = np.concatenate([first.points, second.points])
    triangles = second.triangles[:, ::sign] + len(first.points)
    return ClosedSurface(points, np.concatenate([first.triangles, triangles]))


def test_a_cavity_is_empty_and_parts_that_overlap_are_refused():
    """Corners and edges of the cavity are at centres of cubes, in cells of size 1."""
    hull = surface(pv.Box((0.0, 3.0, 0.0, 3.0, 0.0, 3.0)))
    for samples in (4, 8):
        x, y = 0.5 / samples, 1.0 + 0.5 / samples
        hole = surface(pv.Box((x, y + 1, x, y, 0.25, 2.25)))
        found = lattice.lattice(joined(hull, hole, sign=-1), 1.0, samples=samples)
        exact = 27 - (y + 1 - x) * (y - x) * 2.0
        # A cube whose centre is on an edge counts as half filled, and is so by three quarters.
        error = 0.25 / samples**2 * 4 * (y + 1 - x + y - x + 2.0)
        assert found.fractions.sum() == pytest.approx(exact - error, rel=1e-2)
    twins = joined(BALL, surface(pv.Icosphere(radius=0.5, nsub=3, center=(0.4, 0.1, 0))))
    with pytest.raises(BadInput, match=r"cell = 0.1: .* a surface whose parts do not overlap"):
        lattice.lattice(twins, 0.1)


ROUND = Sphere((0.1, 0.2, 0.3), 0.5)
CLUB = SmoothUnion((Capsule((0, 0, 0), (1, 0, 0), 0.2), Sphere((1, 0, 0), 0.3)), 0.02)


@pytest.mark.mpi
@pytest.mark.parametrize("shape, quality", [(ROUND, 0.1), (CLUB, 0.05)], ids=["ball", "club"])
def test_tetrahedra_of_shapes(comm, shape, quality):
    body = lattice.create_tetrahedra(comm, lambda: shape, 0.15)
    assert [g.label for g in body.groups] == ["surface:boundary", "volume:body"]
    worst = comm.allreduce(mesh_checks.scaled_jacobian(body.domain).min(), op=MPI.MIN)
    assert worst > quality
    if shape is ROUND:
        # Triangles of edge e in a sphere: the missing volume is about (e/r)^2/3 of it.
        assert mesh.volume(body.domain) == pytest.approx(np.pi / 6, rel=0.5 * (0.15 / 0.5) ** 2)


def test_tetrahedra_of_a_file_in_a_scene(tmp_path):
    pv.Icosphere(radius=0.5, nsub=2).save(tmp_path / "ball.stl")
    scene = scenes.Scene(
        name="ball", mesh={"surface": tmp_path / "ball.stl", "size": 0.2}, element="P1",
        material={"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        move=[{"group": "boundary", "translate": (0.1, 0, 0)}],
    )  # fmt: skip
    result = solve(scene, MPI.COMM_SELF)
    assert result.converged
    assert result.record["steps"][-1]["volume_ratio"] == pytest.approx(1, abs=1e-9)
