"""Shapes of obstacles: signed distances and their derivatives."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fem_snh.geometry.shapes import Box, Capsule, Cylinder, Plane, Sphere

pytestmark = pytest.mark.one_debian

A, B = (0.1, -0.2, 0.3), (0.9, 0.5, 0.6)
TURN = (0.3, -0.5, 0.8)
SHAPES = {
    "plane": Plane((0.1, 0.2, 0.3), (1.0, 2.0, -0.5)),
    "sphere": Sphere((0.2, -0.1, 0.3), 0.7),
    "capsule": Capsule(A, B, 0.4),
    "cylinder": Cylinder(A, B, 0.4),
    "infinite cylinder": Cylinder(A, B, 0.4, infinite=True),
    "box": Box((0.1, 0.2, -0.1), (1.0, 0.6, 0.8), TURN),
}
every_shape = pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)


def cylinder_distance(x, a, b, radius):
    """Return the distance from a finite cylinder, from the rectangle that it is around its axis."""
    length = mpmath.norm(b - a)
    along = mpmath.fdot(x - a, b - a) / length
    side = mpmath.norm(x - a - along * (b - a) / length) - radius
    end = max(-along, along - length)
    return mpmath.hypot(max(side, 0), max(end, 0)) + min(max(side, end), 0)


def distance(name, x):
    """Return the signed distance at a point, by another formula, in mpmath's precision."""
    vector = mpmath.matrix
    x, a, b = vector(x), vector(A), vector(B)
    if name == "plane":
        n = vector(SHAPES[name].normal)
        return mpmath.fdot(x - vector(SHAPES[name].point), n) / mpmath.norm(n)
    if name == "sphere":
        return mpmath.norm(x - vector(SHAPES[name].center)) - 0.7
    if name == "capsule":
        t = mpmath.fdot(x - a, b - a) / mpmath.fdot(b - a, b - a)
        return mpmath.norm(x - a - min(max(t, 0), 1) * (b - a)) - 0.4
    if name == "cylinder":
        return cylinder_distance(x, a, b, 0.4)
    if name == "infinite cylinder":
        t = mpmath.fdot(x - a, b - a) / mpmath.fdot(b - a, b - a)
        return mpmath.norm(x - a - t * (b - a)) - 0.4
    box = SHAPES["box"]
    axes = mpmath.matrix(Rotation.from_rotvec(TURN).as_matrix().tolist())
    y = axes.T * (x - vector(box.center))
    q = [abs(c) - mpmath.mpf(s) / 2 for c, s in zip(y, box.size, strict=True)]
    return mpmath.norm([max(c, 0) for c in q]) + min(max(q), 0)


def points(n=60):
    return np.random.default_rng(7).normal(0.3, 0.8, (n, 3))


@pytest.mark.parametrize("name", SHAPES)
def test_distance_and_derivatives_against_50_digits(name):
    x = points()
    found = SHAPES[name].evaluate(x)
    assert found.distance.min() < 0 < found.distance.max()
    h = mpmath.mpf(10) ** -15
    with mpmath.workdps(50):
        for i, place in enumerate(x.tolist()):

            def at(a=0, b=0, c=0, place=place):
                return distance(name, [place[0] + a * h, place[1] + b * h, place[2] + c * h])

            E = np.eye(3, dtype=int)
            gradient = [(at(*e) - at(*-e)) / (2 * h) for e in E]
            hessian = [
                [(at(*e + f) - at(*e - f) - at(*f - e) + at(*-e - f)) / (4 * h * h) for f in E]
                for e in E
            ]
            assert found.distance[i] == pytest.approx(float(at()), abs=1e-14)
            assert np.allclose(found.gradient[i], np.array(gradient, float), atol=1e-13)
            assert np.allclose(found.hessian[i], np.array(hessian, float), rtol=1e-10, atol=1e-10)


@every_shape
def test_the_gradient_has_length_one_and_no_curvature_along_it(shape):
    _, g, H = shape.evaluate(points(2000))
    assert np.allclose(np.linalg.norm(g, axis=1), 1, atol=1e-14)
    assert np.abs(H @ g[:, :, None]).max() < 1e-10  # the derivative of |grad d| = 1
    assert np.allclose(H, np.swapaxes(H, 1, 2), atol=1e-12)


@pytest.mark.parametrize(
    "shape, centre, normal",
    [
        (Sphere((1.0, 2.0, 3.0), 0.5), (1.0, 2.0, 3.0), (1.0, 0.0, 0.0)),
        (Capsule((0.0, 0.0, 0.0), (0.0, 0.0, 2.0), 0.5), (0.0, 0.0, 1.0), None),
        (Cylinder((0.0, 0.0, 0.0), (0.0, 0.0, 2.0), 0.5), (0.0, 0.0, 1.0), None),
        (Box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0)),
    ],
)
def test_on_the_medial_axis_the_derivatives_are_finite(shape, centre, normal):
    d, g, H = shape.evaluate(np.array([centre]))
    assert d[0] == pytest.approx(-0.5)
    assert np.linalg.norm(g[0]) == pytest.approx(1)
    assert np.isfinite(H).all()
    if normal:
        assert g[0] == pytest.approx(normal)
    else:
        assert g[0, 2] == 0  # a normal of the axis


def test_the_edges_of_a_cylinder_are_rounded_outside():
    """Beyond the rim of a cylinder the curvatures are 1/d and a/(d rho), by Gauss' formula."""
    shape = Cylinder((0.0, 0.0, -1.0), (0.0, 0.0, 1.0), 2.0)
    d, g, H = shape.evaluate(np.array([[5.0, 0.0, 5.0]]))
    assert d[0] == pytest.approx(5.0)
    assert g[0] == pytest.approx([0.6, 0, 0.8])
    assert np.linalg.eigvalsh(H[0]) == pytest.approx([0, 0.6 / 5, 1 / 5], abs=1e-14)
