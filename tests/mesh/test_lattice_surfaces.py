"""Lattices of closed surfaces: volumes, skins and mistakes."""

from __future__ import annotations

import numpy as np
import pytest
import pyvista as pv

from fem_snh.geometry.shapes import ClosedSurface
from fem_snh.geometry.shapes.closed_surface import check_closed
from fem_snh.mesh import lattice


def surface(mesh: pv.PolyData) -> ClosedSurface:
    """Return a surface of PyVista's."""
    mesh = mesh.triangulate().clean()
    return ClosedSurface(np.asarray(mesh.points, float), np.asarray(mesh.regular_faces, np.int64))


def volume(points: np.ndarray, triangles: np.ndarray) -> float:
    """Return the volume that triangles enclose."""
    a, b, c = (points[triangles[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6)


BALL = surface(pv.Icosphere(radius=0.5, nsub=3))
BOX = surface(pv.Box((0.0, 1.0, 0.0, 0.6, 0.0, 0.4)))
TORUS = surface(pv.ParametricTorus(ringradius=0.5, crosssectionradius=0.2))


@pytest.mark.parametrize("body", [BALL, BOX, TORUS], ids=["ball", "box", "torus"])
@pytest.mark.parametrize("cell", [0.17, 0.1])
def test_volume_and_skin(body, cell):
    data = lattice.lattice(body, cell)
    exact = volume(body.points, body.triangles)
    # Walls of the box along the lines count by whole columns of cubes, a quarter of a cell wide.
    assert data.fractions.sum() * cell**3 == pytest.approx(exact, rel=0.12 * cell)
    skin = data.skin
    check_closed(skin.points, skin.triangles.astype(np.int64), "skin")
    assert volume(skin.points, skin.triangles) == pytest.approx(exact, rel=1e-12)
    xi = (skin.points - data.x[data.cells[skin.cells, 0]]) / cell
    assert xi.min() > -0.011 and xi.max() < 1.011
    edges = skin.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert np.linalg.norm(skin.points[edges[:, 0]] - skin.points[edges[:, 1]], axis=1).max() <= cell


def test_lines_through_corners_and_edges_count_once():
    """All corners and edges are on lines of samples: the fractions are those of the box."""
    for samples in (2, 4):
        x, y = 0.5 / samples, 1.0 + 0.5 / samples  # centres of cubes in cells of size 1
        bounds = (x, y + 1, x, y, 0.25, 2.25)
        box = surface(pv.Box(bounds))
        whole = surface(pv.Box((0.0, 3.0, 0.0, 3.0, 0.0, 3.0)))
        both = ClosedSurface(
            np.concatenate([whole.points, box.points]),
            np.concatenate([whole.triangles, box.triangles[:, ::-1] + len(whole.points)]),
        )  # a cavity
        found = lattice.lattice(both, 1.0, samples=samples)
        cavity = (y + 1 - x) * (y - x) * 2.0
        assert found.fractions.sum() == pytest.approx(27 - cavity, abs=2e-3)
