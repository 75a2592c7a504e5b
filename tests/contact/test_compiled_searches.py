"""The compiled searches of contact beside dolfinx's elements, brute force and definitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import csr_matrix

from fem_snh import _dolfinx
from fem_snh.assembly.cell_search import CellMap, points_in_boxes
from fem_snh.contact.closest_points import Triangles, intersect

pytestmark = pytest.mark.one_debian
CELLS = ("triangle", "quadrilateral", "tetrahedron", "hexahedron")


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("kind", CELLS)
def test_the_map_of_a_cell_is_that_of_its_shape_functions(kind: str, degree: int) -> None:
    """Positions and determinants of curved cells, and the inverse of the map."""
    random = np.random.default_rng(1)
    nodes = _dolfinx.reference_nodes(kind, degree)
    dim = nodes.shape[1]
    y = 3 * nodes + 0.05 * random.normal(size=(50, *nodes.shape))
    xi = random.uniform(0.1, 0.3, (50, dim))
    table = _dolfinx.tabulate_element(kind, degree, xi, 1)
    x, det = CellMap(kind, degree).evaluate(y, xi)
    np.testing.assert_allclose(x, np.einsum("nk,nki->ni", table[0], y), atol=1e-13)
    J = np.einsum("jnk,nki->nij", table[1:], y)
    np.testing.assert_allclose(det, np.linalg.det(J), atol=1e-11)
    found, outside, converged = CellMap(kind, degree).invert(y, x)
    assert converged.all() and (outside < 0).all()
    np.testing.assert_allclose(found, xi, atol=1e-9)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("count", [1, 300])
def test_points_in_boxes_are_those_of_all_pairs(dim: int, count: int) -> None:
    """Also of clustered points, boxes of very different sizes, and NaN."""
    random = np.random.default_rng(2)
    points = random.normal(size=(count, dim)) ** 3
    points[count // 2, 0] = np.nan
    low = random.normal(size=(200, dim))
    high = low + random.uniform(0, 2, (200, 1)) ** 4
    low[0], high[0] = -np.inf, np.inf
    point, box = points_in_boxes(points, low, high)
    inside = ((points[:, None] >= low) & (points[:, None] <= high)).all(axis=2)
    assert (np.diff(box) >= 0).all() and len(point) == inside.sum()
    assert inside[point, box].all()
    assert len({*zip(point.tolist(), box.tolist(), strict=True)}) == len(point)


def test_rows_with_a_common_entry() -> None:
    random = np.random.default_rng(3)
    a, b = (csr_matrix(random.uniform(size=(40, 30)) < 0.1) for _ in range(2))
    rows, others = random.integers(0, 40, (2, 500))
    expected = (a[rows].toarray() & b[others].toarray()).any(axis=1)
    assert 50 < expected.sum() < 450
    np.testing.assert_array_equal(intersect(a, rows, b, others), expected)


@pytest.mark.parametrize("dim", [2, 3])
def test_closest_points_are_no_farther_than_others(dim: int) -> None:
    """They are in the triangle, and the arm makes no acute angle with the way to any corner."""
    random = np.random.default_rng(4)
    corners, points = random.normal(size=(30, dim, dim)), 2 * random.normal(size=(200, dim))
    outward, normals = random.normal(size=(30, dim)), random.normal(size=(200, dim))
    every = np.tile(np.arange(30), (200, 1))
    triangles = Triangles(corners, outward)
    found = triangles.examine(points, normals, every)
    assert found.coordinates.min() >= 0
    np.testing.assert_allclose(found.coordinates.sum(axis=2), 1, rtol=1e-13)
    place = np.einsum("nkc,kci->nki", found.coordinates, corners)
    np.testing.assert_allclose(points[:, None] - place, found.arm, atol=1e-13)
    ways = corners - place[:, :, None]
    assert np.einsum("nki,nkci->nkc", found.arm, ways).max() < 1e-12
    np.testing.assert_allclose(found.cosine, normals @ outward.T, atol=1e-13)

    sizes = random.uniform(0.1, 1, 200)
    targets = triangles.targets(points, normals, sizes, every)
    np.testing.assert_array_equal(targets.nearest, found.distance.argmin(axis=1))
    beside = (1 + found.cosine) / 2
    turned = found.distance * (1 + 2 * beside) + beside / 2 * sizes[:, None]
    np.testing.assert_array_equal(targets.target, turned.argmin(axis=1))
    # With all triangles around each of them, the first step finds the target, too.
    walked = triangles.walk(points, normals, sizes, np.zeros(200, int), every[:30])
    np.testing.assert_array_equal(walked[0], targets.target)
    np.testing.assert_allclose(walked[1], targets.coordinates, atol=1e-15)
