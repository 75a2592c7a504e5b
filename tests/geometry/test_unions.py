"""Unions of shapes: distances and their derivatives."""

from __future__ import annotations

import numpy as np
import pytest

from fem_snh.geometry.shapes import Box, Capsule, Cylinder, Plane, SmoothUnion, Sphere, Union

pytestmark = pytest.mark.one_debian

PARTS = (
    Sphere((0.2, -0.1, 0.3), 0.7),
    Capsule((0.1, -0.2, 0.3), (0.9, 0.5, 0.6), 0.4),
    Box((0.1, 0.2, -0.8), (1.0, 0.6, 0.8), (0.3, -0.5, 0.8)),
    Cylinder((-0.5, 0.0, 0.0), (-1.5, 0.3, 0.1), 0.3),
)
BLEND = 0.15


def points(n=2000):
    return np.random.default_rng(7).normal(0.1, 0.8, (n, 3))


def differences(f, x, h=1e-5):
    """Return the central differences of f at points x (n, 3), with the direction last."""
    return np.stack([(f(x + h * e) - f(x - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)


@pytest.mark.parametrize("shape", [*PARTS, Plane(), Cylinder((0, 0, 0), (1, 1, 1), 0.2, True)])
def test_distance_is_that_of_evaluate(shape):
    assert np.allclose(shape.distance(points()), shape.evaluate(points()).distance, atol=1e-15)


def test_union_is_the_least_of_its_parts_with_their_derivatives():
    x, union = points(), Union(PARTS)
    d, g, H = union.evaluate(x)
    parts = [part.evaluate(x) for part in PARTS]
    first = np.argmin([part.distance for part in parts], axis=0)
    assert set(first) == {0, 1, 2, 3}
    assert np.allclose(
        union.distance(x), np.min([part.distance for part in parts], axis=0), 0, 1e-15
    )
    for i, part in enumerate(parts):
        mine = first == i
        assert np.array_equal(d[mine], part.distance[mine])
        assert np.array_equal(g[mine], part.gradient[mine])
        assert np.array_equal(H[mine], part.hessian[mine])


def test_derivatives_of_a_smooth_union_by_differences():
    x, union = points(), SmoothUnion(PARTS, BLEND)
    # Away from medial axes, edges and corners, where the parts' own derivatives jump.
    jumps = [
        np.abs(a.hessian - b.hessian).max(axis=(1, 2))
        for part in PARTS
        for e in np.eye(3)
        for a, b in [(part.evaluate(x + 2e-5 * e), part.evaluate(x - 2e-5 * e))]
    ]
    x = x[np.max(jumps, axis=0) < 0.02]
    assert len(x) > 1000
    d, g, H = union.evaluate(x)
    assert np.allclose(d, union.distance(x), atol=1e-15)
    assert np.allclose(g, differences(union.distance, x), atol=1e-7)
    by_gradient = differences(lambda y: union.evaluate(y).gradient, x)
    assert np.allclose(H, by_gradient, atol=1e-5)
    assert np.linalg.norm(g, axis=1).max() <= 1 + 1e-14


def test_a_smooth_union_is_between_its_bounds_in_any_order():
    x, union = points(), SmoothUnion(PARTS, BLEND)
    least = Union(PARTS).distance(x)
    d = union.distance(x)
    assert np.all(d <= least) and np.all(d >= least - 2 * BLEND)  # log2 of four parts
    assert np.allclose(d, SmoothUnion(PARTS[::-1], BLEND).distance(x), atol=1e-14)
    assert np.allclose(SmoothUnion(PARTS, 1e-6).distance(x), least, atol=2e-6)


def test_where_two_surfaces_meet_the_smooth_one_is_outside_by_the_blend():
    balls = Sphere((-1.0, 0, 0), 1.25), Sphere((1.0, 0, 0), 1.25)
    x = np.array([[0.0, 0.75, 0.0]])
    assert SmoothUnion(balls, 0.05).distance(x) == pytest.approx([-0.05], abs=1e-15)
