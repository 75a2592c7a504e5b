"""The triangles of a body's boundary: closed, outward, equal on all ranks, moved by the nodes."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import cube
from polynomials import ELEMENTS

from fem_snh import _dolfinx
from fem_snh.contact.gathered_surface import embedded_surface
from fem_snh.mesh import mesh

pytestmark = pytest.mark.mpi

each_element = pytest.mark.parametrize("cell, degree", ELEMENTS, ids=["Q1", "P1", "Q2", "P2"])
#: An affine displacement x -> G x + c of determinant det(I + G).
G = np.array([[0.2, 0.3, -0.1], [0, -0.1, 0.4], [0.2, 0, 0.1]])


def on(comm, cell, degree):
    """Return the surface of a cube and the nodal values of the affine displacement."""
    body = cube(comm, cell, 3)
    V = _dolfinx.function_space(body.domain, degree, (3,))
    u = V.tabulate_dof_coordinates()[: sum(_dolfinx.num_nodes(V))] @ G.T + [1, 2, 3]
    return embedded_surface(V, body.skin), u, mesh.volume(body.domain)


def enclosed(x, triangles):
    """The volume within triangles by the divergence theorem, of x/3."""
    a, b, c = np.moveaxis(x[triangles], 1, 0)
    return np.einsum("ti,ti->", a, np.cross(b, c)) / 6


@pytest.mark.one_debian("ranks")
@each_element
def test_the_divergence_theorem(comm, cell, degree):
    surface, u, volume = on(comm, cell, degree)
    found = enclosed(surface.positions(0 * u), surface.triangles)
    assert found == pytest.approx(volume, rel=1e-14)
    found = enclosed(surface.positions(u), surface.triangles)
    assert found == pytest.approx(volume * np.linalg.det(np.eye(3) + G), rel=1e-13)
    assert len(surface.triangles) == 6 * 9 * 2 * degree**2


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("cell", ["tetrahedron", "hexahedron"])
def test_no_triangle_is_flipped(comm, cell, degree):
    """They cover the cube's faces once. Degree 3, of error estimates, has no equal spacing."""
    surface, _, _ = on(comm, cell, degree)
    x = surface.points[surface.triangles]
    normals = np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]) / 2
    assert np.einsum("ti,ti->t", normals, x.mean(axis=1) - surface.points.mean(axis=0)).min() > 0
    assert np.linalg.norm(normals, axis=1).sum() == pytest.approx(6, rel=1e-12)


@each_element
def test_equal_on_all_ranks(comm, cell, degree):
    """The same bits on all ranks, and the same surface as on one rank alone."""
    surface, u, _ = on(comm, cell, degree)
    x = surface.positions(u)
    arrays = surface.points, surface.triangles, surface.nodes, x
    for other in comm.allgather(arrays):
        for mine, theirs in zip(arrays, other, strict=True):
            np.testing.assert_array_equal(mine, theirs)
    alone, u, _ = on(MPI.COMM_SELF, cell, degree)
    np.testing.assert_array_equal(surface.triangles, alone.triangles)
    np.testing.assert_allclose(x, alone.positions(u), atol=1e-14)
