"""Obstacles of triangles: signed distances of closed surfaces from STL files."""

from __future__ import annotations

import numpy as np
import pytest

from fem_snh.geometry.shapes import Box, ClosedSurface, Sphere

pyvista = pytest.importorskip("pyvista")


def sphere(n):
    """Return the surface of a unit sphere, an octahedron with edges in n parts."""
    mesh = pyvista.Octahedron().subdivide(int(np.log2(n)), "linear").triangulate()
    mesh.points /= np.linalg.norm(mesh.points, axis=1)[:, None]
    return mesh.compute_normals(cell_normals=True, point_normals=False, auto_orient_normals=True)


def points(n=300):
    x = np.random.default_rng(5).normal(0, 1, (n, 3))
    return (
        x / np.linalg.norm(x, axis=1)[:, None] * np.random.default_rng(6).uniform(0.6, 1.4, (n, 1))
    )


@pytest.mark.one_debian
def test_a_sphere_of_triangles_converges_to_the_sphere(tmp_path):
    errors = []
    for n in (8, 16):
        sphere(n).save(tmp_path / "ball.stl")
        found = ClosedSurface.read(tmp_path / "ball.stl").evaluate(points())
        exact = Sphere().evaluate(points())
        assert np.allclose(np.linalg.norm(found.gradient, axis=1), 1, atol=1e-12)
        assert not found.hessian.any()
        errors.append(
            [
                np.abs(found.distance - exact.distance).max(),
                np.linalg.norm(found.gradient - exact.gradient, axis=1).max(),
            ]
        )
    assert errors[1][0] < 0.3 * errors[0][0] < 0.1  # second order in the size of the triangles
    assert errors[1][1] < 0.6 * errors[0][1] < 0.3  # first order


@pytest.mark.one_debian
@pytest.mark.parametrize("binary", [True, False])
def test_a_box_of_triangles_is_the_box(tmp_path, binary):
    """A box is exact, also at its edges and corners, where the sign is hard to find."""
    pyvista.Box((-0.5, 0.5, -1, 1, -0.25, 0.25)).triangulate().save(
        tmp_path / "box.stl", binary=binary
    )
    surface, x = ClosedSurface.read(tmp_path / "box.stl"), 1.2 * points(2000)
    exact = Box(size=(1.0, 2.0, 0.5)).evaluate(x)
    found = surface.evaluate(x)
    assert found.distance == pytest.approx(exact.distance, abs=1e-12)
    off = (
        np.abs(
            np.sort(np.abs(x) - [0.5, 1, 0.25])[:, -1] - np.sort(np.abs(x) - [0.5, 1, 0.25])[:, -2]
        )
        > 1e-6
    )
    assert np.allclose(found.gradient[off], exact.gradient[off], atol=1e-9)


@pytest.mark.one_debian
def test_on_the_surface_the_gradient_is_the_normal(tmp_path):
    pyvista.Cube().triangulate().save(tmp_path / "cube.stl")
    surface = ClosedSurface.read(tmp_path / "cube.stl")
    d, g, _ = surface.evaluate(np.array([[0.5, 0.1, 0.2], [0.1, -0.5, 0.2]]))
    assert np.abs(d).max() < 1e-15
    assert np.allclose(g, [[1, 0, 0], [0, -1, 0]])
