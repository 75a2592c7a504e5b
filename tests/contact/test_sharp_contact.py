"""Self-contact of corners and edges: `reference` stops them, and reports how deep they are."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import contact_problems
import numpy as np
import pytest
from bodies import Condition, Hold, create_problem
from scipy.spatial.transform import Rotation

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.unknowns import local_values
from fem_snh.contact.closest_points import PseudoNormals, Triangles
from fem_snh.contact.gathered_surface import embedded_surface
from fem_snh.contact.reference_contact import ReferenceContact, SurfaceEdges
from fem_snh.contact.samples import SurfaceSamples, cell_sizes, smallest_at_points
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh

COMM = MPI.COMM_WORLD
mpi = pytest.mark.mpi
#: Turns of the lower and of the upper block: the space diagonal of the upper one becomes vertical,
#: or an edge of each is on top and at the bottom, at 90 degrees to each other.
DIAGONAL = Rotation.from_rotvec(np.arccos(1 / 3**0.5) * np.array([1.0, -1.0, 0.0]) / 2**0.5)
TURNS = {
    "corner": (Rotation.identity(), DIAGONAL),
    "edges": (Rotation.from_rotvec([0, np.pi / 4, 0]), Rotation.from_rotvec([np.pi / 4, 0, 0])),
}


def press(kind: str, comm: MPI.Comm, element: str) -> Any:
    """Press a turned block of one cell on another one; return the surface and the last row."""
    chosen = ELEMENTS[element]
    body = mesh.generate(comm, "two_blocks", chosen.cell, cells=1, gap=1.0)
    X = _dolfinx.geometry_x(body.domain)
    upper, ends = X[:, 2] > 1.5, []
    for part, turn, center in zip((~upper, upper), TURNS[kind], (0.5, 2.5), strict=True):
        middle = np.array([0.5, 0.5, center])
        X[part] = turn.apply(X[part] - middle) + middle
        z = X[part, 2]
        ends.append(comm.allreduce(z.max(initial=-9), op=MPI.MAX))
        ends.append(comm.allreduce(z.min(initial=9), op=MPI.MIN))
    # 0.01 apart; off the middle, where every direction is preferred by rounding errors alone.
    X[upper] += [0.07, 0.05, ends[0] - ends[3] + 0.01]
    p = create_problem(
        body,
        chosen,
        material("stable_neo_hookean", 1.0, 0.3),
        hold=[Hold("bottom")],
        move=[Condition("top", lambda X, load: 0 * X - [0, 0, 0.3 * load])],
        loads=lambda body, u, regions, _: [ReferenceContact(u.function_space, body.skin, regions)],
    )
    row = contact_problems.press(p, 3, 1e-9)
    surface = p.terms[1].surface
    x = surface.positions(local_values(p.split(p.x)[0]).reshape(-1, 3))
    return x, surface.triangles, row["self_contact"]


def press_on_all_and_alone(kind: str, element: str) -> Any:
    """Return the last row and the depth by `deepest`, if each rank finds the same by itself."""
    x, triangles, row = press(kind, COMM, element)
    alone = press(kind, MPI.COMM_SELF, element)[2]
    assert row["pairs"] == alone["pairs"]
    assert row["force"] == pytest.approx(alone["force"], rel=1e-5)
    return row, deepest(x, triangles)


def deepest(x: np.ndarray, triangles: np.ndarray) -> float:
    """Return the depth of the deepest point of either block's surface in the other one.

    Of a fine grid of points on every triangle: whether a point is inside is decided by the solid
    angle of the other surface, its depth by the distance from all triangles.
    """
    of_triangle, found = np.arange(len(triangles)) < len(triangles) // 2, 0.0
    m = 40
    grid = np.array([(i, j, m - i - j) for i in range(m + 1) for j in range(m + 1 - i)]) / m
    for own in (of_triangle, ~of_triangle):
        assert not np.isin(triangles[own], triangles[~own]).any()  # each half is a block
        points = np.einsum("qk,tki->tqi", grid, x[triangles[own]]).reshape(-1, 3)
        other = x[triangles[~own]]
        arms = other[None] - points[:, None, None]
        a, b, c = (arms[:, :, k] for k in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
        triple = np.einsum("nti,nti->nt", a, np.cross(b, c))
        ab, bc, ca = (np.einsum("nti,nti->nt", v, w) for v, w in ((a, b), (b, c), (c, a)))
        angle = 2 * np.arctan2(triple, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1)
        inside = np.abs(angle) > 2 * np.pi
        if inside.any():
            every = np.tile(np.arange(len(other)), (inside.sum(), 1))
            others = Triangles(other, np.zeros((len(other), 3)))
            distance = others.examine(points[inside], points[inside], every).distance
            found = max(found, distance.min(axis=1).max())
    return float(found)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q1", "P1"])
def test_a_corner_stops_at_a_face(element: str) -> None:
    """Samples inside of the facets let it in to 0.10 (Q1), and reported 0.015."""
    row, depth = press_on_all_and_alone("corner", element)
    assert row["penetration"] == pytest.approx(depth, rel=1e-9)
    # It would go 0.29 deep; the tetrahedron at the corner has 3 triangles for 3 to 6 of hexahedra.
    assert 0 < row["penetration"] < (0.03 if element == "Q1" else 0.05)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q1", "P1"])
def test_an_edge_stops_at_an_edge(element: str) -> None:
    """At 90 degrees, no sample of either is in the other: they passed by 0.17, and reported 0.004.

    Two edges that have passed each other by d are d / sqrt(2) deep in wedges of 90 degrees.
    """
    row, depth = press_on_all_and_alone("edges", element)
    assert depth <= row["penetration"] < 0.02 and row["force"] > 0.04


def surface_of(source: str, cell: str, degree: int = 1, **parameters: float) -> Any:
    """Return a space of displacements, and the surface of its body."""
    body = mesh.generate(MPI.COMM_SELF, source, cell, **parameters)
    V = _dolfinx.function_space(body.domain, degree, (3,))
    return V, embedded_surface(V, body.skin)


@pytest.mark.parametrize(("cell", "degree"), [("hexahedron", 1), ("tetrahedron", 2)])
def test_samples_are_at_corners_and_integrate(cell: str, degree: int) -> None:
    """Every vertex is a sample, once; the unit cube's area is 6, its moments those of its faces."""
    V, surface = surface_of("cube", cell, degree, cells=2)
    samples = SurfaceSamples(surface, smallest_at_points(V, surface, cell_sizes(V)))
    points = samples.at(surface.points)
    assert len(np.unique(np.round(points, 9), axis=0)) == len(points)
    apart = np.linalg.norm(points[:, None] - surface.points, axis=2)
    np.testing.assert_array_equal((apart < 1e-12).sum(axis=0), 1)
    moments = [samples.areas.sum(), *(samples.areas @ points)]
    np.testing.assert_allclose(moments, [6.0, 3.0, 3.0, 3.0], rtol=1e-12)
    if degree == 1:  # 4 faces with the integral of x^3 and one with that of 1
        assert samples.areas @ points[:, 0] ** 3 == pytest.approx(4 / 4 + 1, rel=1e-12)


@pytest.mark.parametrize("depth", [-0.1, 0.1])
def test_crossing_edges_of_two_cubes_are_found(depth: float) -> None:
    """One pair, at the place, with the normal and the gap of the geometry."""
    _, surface = surface_of("cube", "hexahedron", cells=1)
    triangles = surface.triangles
    lower, upper = (turn.apply(surface.points - 0.5) for turn in TURNS["edges"])
    upper += [0.1, 0.05, lower[:, 2].max() - upper[:, 2].min() - depth]
    x = np.concatenate([lower, upper])
    both = np.concatenate([triangles, triangles + len(lower)])
    edges = SurfaceEdges(both)
    assert len(edges) == 36  # of each cube 12 edges and a diagonal of each face
    found = edges.crossings(x, PseudoNormals(both).of(x).outward, 0.2)
    assert len(found.first) == 1
    ends = [x[edges.points[e[0]]] for e in (found.first, found.second)]
    points = [(1 - s) * a + s * b for s, (a, b) in zip(found.place[0], ends, strict=True)]
    np.testing.assert_allclose(np.array(points)[:, :2], [[0.0, 0.05]] * 2, atol=1e-12)
    np.testing.assert_allclose(np.abs(found.normal[0]), [0, 0, 1], atol=1e-12)
    assert found.normal[0] @ (points[0] - points[1]) == pytest.approx(-depth, abs=1e-12)
    assert found.facing[0] == pytest.approx(np.sin(np.pi / 4))


def test_averaged_normals_are_continuous_up_to_a_sharp_edge() -> None:
    """On an edge of a wave both triangles give the same normal; at the rim of a cube, their own."""
    _, surface = surface_of("two_blocks", "hexahedron", cells=4, gap=0.5)
    triangles, x = surface.triangles, surface.points.copy()
    x[:, 2] += 0.02 * np.sin(7 * x[:, 0] + 4 * x[:, 1])
    normals = PseudoNormals(triangles).of(x)
    outward = normals.outward
    edges = SurfaceEdges(triangles)
    cosine = np.einsum("ni,ni->n", *(outward[edges.triangles[:, i]] for i in (0, 1)))
    found, jumps = [], []
    for side in (0, 1):
        chosen = edges.triangles[:, side]
        on = [(triangles[chosen] == edges.points[:, [i]]) * w for i, w in ((0, 0.3), (1, 0.7))]
        found.append(normals.averaged(chosen, on[0] + on[1], 0.9))
        jumps.append(np.linalg.norm(found[-1] - outward[chosen], axis=1))
    np.testing.assert_allclose(np.linalg.norm(found[0], axis=1), 1.0, rtol=1e-12)
    rim = cosine < 0.5
    inner = ~rim & (np.abs(x[edges.points].mean(axis=1)[:, :2] - 0.5) < 0.3).all(axis=1)
    assert rim.sum() > 50 and inner.sum() > 50 and cosine[inner].min() < 0.99
    np.testing.assert_allclose(found[0][inner], found[1][inner], atol=1e-12)
    assert max(jump[rim].max() for jump in jumps) < 0.2
