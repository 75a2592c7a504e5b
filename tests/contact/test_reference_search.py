"""The search of self-contact: points in deformed cells, closest points, neighbours, bodies."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import cube, wave
from polynomials import ELEMENTS
from scipy.spatial.transform import Rotation

from fem_snh import _dolfinx
from fem_snh.assembly.connected_parts import connected_parts
from fem_snh.contact.closest_points import PseudoNormals
from fem_snh.contact.gathered_surface import embedded_surface
from fem_snh.contact.samples import DeformedCells, Neighbourhood
from fem_snh.contact.triangle_search import ReferenceSurface, approaching
from fem_snh.mesh import mesh

pytestmark = [pytest.mark.mpi, pytest.mark.one_debian("ranks")]
each_element = pytest.mark.parametrize("cell, degree", ELEMENTS, ids=["Q1", "P1", "Q2", "P2"])
#: A rotation by a radian and a translation.
R, T = Rotation.from_rotvec([0.6, -0.5, 0.6]).as_matrix(), np.array([0.3, -1.0, 2.0])


def nothing(point, cell):
    return np.zeros(len(point), bool)


@each_element
def test_points_are_found_where_they_came_from(comm, cell, degree):
    """Points of each cell, moved by its shape functions, are in it, and keep their coordinates."""
    body = cube(comm, cell, 2, bend=0.05)
    V = _dolfinx.function_space(body.domain, degree, (3,))
    X, nodes = V.tabulate_dof_coordinates(), _dolfinx.node_dofs(V)
    u = X @ (R - np.eye(3)).T + T + wave(0.02)(X)
    inner = 0.8 * _dolfinx.reference_corners(cell) + 0.2 * 0.25
    basis = _dolfinx.tabulate_values(V, inner)
    here, there = (np.einsum("pk,cki->cpi", basis, v[nodes]) for v in (X, X + u))
    hits, found = DeformedCells(V).find(u, there.reshape(-1, 3), nothing)
    own = hits.cell == hits.point // len(inner)
    assert np.array_equal(np.sort(hits.point[own]), np.arange(here.shape[0] * len(inner)))
    np.testing.assert_allclose(found[own], here.reshape(-1, 3)[hits.point[own]], atol=1e-8)
    assert hits.outside[own].max() < 1e-6
    # Neighbours of a cell are found within a margin, the others not.
    assert hits.outside[~own].min(initial=0.1) >= -1e-6 and hits.outside.max() <= 0.1


def test_closest_points_are_those_of_all_triangles(comm):
    """Against a search of all triangles; inside and outside of a bent cube."""
    body = cube(comm, "tetrahedron", 4, bend=0.1)
    V = _dolfinx.function_space(body.domain, 1, (3,))
    surface = embedded_surface(V, body.skin)
    triangles = surface.triangles
    search = ReferenceSurface(surface.points, triangles, np.zeros(len(triangles), int))
    p = np.random.default_rng(2).random((150, 3)) * 1.4 - 0.2
    none = np.zeros((len(triangles), 3))
    found = search.closest(p, np.zeros(len(p), int), 0 * p, np.ones(len(p)), none)
    inside = ((p > 0) & (p < 1)).all(axis=1)  # the bend leaves the boundary where it is
    outside = -np.linalg.norm(p - np.clip(p, 0, 1), axis=1)
    expected = np.where(inside, np.minimum(p, 1 - p).min(axis=1), outside)
    np.testing.assert_allclose(found.depth, expected, atol=1e-12)
    x = np.einsum("nk,nki->ni", found.coordinates, surface.points[triangles[found.triangle]])
    np.testing.assert_allclose(np.linalg.norm(x - p, axis=1), np.abs(expected), atol=1e-12)


def surface_of(comm, source, **parameters):
    """Return the points, triangles and outward normals of a mesh's surface."""
    body = mesh.generate(comm, source, "hexahedron", **parameters)
    surface = embedded_surface(_dolfinx.function_space(body.domain, 1, (3,)), body.skin)
    outward = PseudoNormals(surface.triangles).of(surface.points).outward
    return surface.points, surface.triangles, outward


def test_surfaces_that_face_each_other_approach(comm):
    """Only the faces of two blocks that face each other, up to the distance and no farther."""
    x, triangles, outward = surface_of(comm, "two_blocks", cells=3, gap=0.3)
    points = x[triangles].mean(axis=1)
    found = approaching(points, outward, x[triangles], outward, 0.31)
    faces = np.isclose(points[:, 2], 1.0) | np.isclose(points[:, 2], 1.3)
    np.testing.assert_array_equal(np.sort(found.sample), np.flatnonzero(faces))
    target = np.einsum("nk,nki->ni", found.coordinates, x[triangles[found.triangle]])
    expected = points[found.sample] + 0.3 * outward[found.sample]
    np.testing.assert_allclose(target, expected, atol=1e-12)
    assert not len(approaching(points, outward, x[triangles], outward, 0.29).sample)
    # A surface is not approached from behind: the blocks overlap.
    x, triangles, outward = surface_of(comm, "two_blocks", cells=3, gap=-0.1)
    points = x[triangles].mean(axis=1)
    assert not len(approaching(points, outward, x[triangles], outward, 0.31).sample)


@each_element
def test_neighbours_and_bodies(comm, cell, degree):
    """Cells share a vertex with the triangles of their own facets; two blocks are two bodies."""
    body = mesh.generate(comm, "two_blocks", cell, cells=3, gap=0.5)
    V = _dolfinx.function_space(body.domain, degree, (3,))
    surface = embedded_surface(V, body.skin)
    near = Neighbourhood(V, surface)
    most = 4 if (cell, degree) == ("hexahedron", 2) else 3
    assert near.triangles.getnnz(axis=1).max() == most
    X, nodes = V.tabulate_dof_coordinates(), _dolfinx.node_dofs(V)
    middles = surface.points[surface.triangles].mean(axis=1)
    low, high = X[nodes].min(axis=1), X[nodes].max(axis=1)
    triangle, local = (i.ravel() for i in np.indices((len(middles), len(nodes))))
    below = middles[triangle] >= low[local] - 1e-9
    inside = (below & (middles[triangle] <= high[local] + 1e-9)).all(axis=1)
    shares = near.share(triangle, local)
    if cell == "hexahedron":
        assert shares[inside].all()
    apart = np.linalg.norm(middles[triangle] - (low + high)[local] / 2, axis=1)
    assert not shares[apart > 0.8].any()

    numbers, _ = connected_parts(V)
    upper = X[:, 2] > 1.25
    both = [set(np.concatenate(comm.allgather(numbers[part]))) for part in (upper, ~upper)]
    assert len(both[0]) == len(both[1]) == 1 and both[0] != both[1]
