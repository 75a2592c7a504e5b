"""The closed-form eigensystem of the Hessian and the equations of Smith et al. 2018."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from points import KINDS, PAIRS, deformations, every_kind, every_material, make, spread, vec

from benchmarks.eigensolvers import cubic_coefficients, cubic_vector
from fem_snh.choices import EIGENSOLVERS
from fem_snh.kernels.material import svd

pytestmark = pytest.mark.one_debian

APPENDIX_A = {
    3: [[0, 0, 0], [0, 0, 1], [0, -1, 0]],
    4: [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
    5: [[0, 1, 0], [-1, 0, 0], [0, 0, 0]],
    6: [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    7: [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
    8: [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
}


@pytest.mark.parametrize("solver", EIGENSOLVERS)
@every_kind
@every_material
def test_eigensystem(m, kind, solver):
    """H v = lambda v, orthonormal vectors, the order of Smith et al. 2018 and its Appendix A."""
    m = make(*m)
    F = deformations(KINDS[kind], seed=9)
    values, vectors = m.eigensystem(F, solver)
    H = m.hessian(F)
    size = spread(H)[:, None, None]
    assert np.all(abs(H @ vectors - vectors * values[:, None, :]) <= 2e-14 * size)
    assert abs(np.swapaxes(vectors, 1, 2) @ vectors - np.eye(9)).max() <= 1e-14
    assert np.all(np.diff(values[:, :3], axis=1) <= 1e-14 * size[:, 0])
    U, _, V = svd(F)
    for k, D in APPENDIX_A.items():
        expected = vec(U @ np.array(D) @ np.swapaxes(V, 1, 2)) / np.sqrt(2)
        assert abs(vectors[:, :, k] - expected).max() <= 1e-14


@pytest.fixture(scope="module")
def block():
    """H + rho g g^T + eta f f^T in the frame of the stretches, symbolically, and its symbols."""
    s, (eta, rho, e) = sympy.symbols("s0:3"), sympy.symbols("eta rho e")
    H = sympy.Matrix([[0, s[2], s[1]], [s[2], 0, s[0]], [s[1], s[0], 0]])
    g, f = sympy.Matrix([s[1] * s[2], s[0] * s[2], s[0] * s[1]]), sympy.Matrix(s)
    return H + rho * g * g.T + eta * f * f.T, s, eta, rho, e


def test_equations_42_and_66(block):
    A, s, eta, rho, e = block
    polynomial = sympy.Poly((e * sympy.eye(3) - A).det(), e).all_coeffs()
    for found, expected in zip(polynomial[1:], cubic_coefficients(s, eta, rho), strict=True):
        assert sympy.expand(found - expected) == 0
    J, I_C = s[0] * s[1] * s[2], sum(x**2 for x in s)
    g = sum((s[j] * s[k]) ** 2 for j, k in PAIRS)
    eq66 = e**3 - rho * g * e**2 - (1 + 2 * rho * J) * I_C * e - (2 + 3 * rho * J) * J
    ours = e**3 + sum(c * e**k for c, k in zip(cubic_coefficients(s, 0, rho), (2, 1, 0)))
    assert sympy.expand(eq66 - ours) == 0


def test_equation_44_has_one_wrong_sign_and_equation_67_none(block):
    A, s, eta, rho, e = block
    d = cubic_vector(s, e, eta, rho)
    B = A - e * sympy.eye(3)
    cross = B.row(0).cross(B.row(1))  # spans the null space of B at a simple root e
    assert [sympy.expand(x - y) for x, y in zip(cross, d, strict=True)] == [0, 0, 0]
    # alpha_1 as printed, with s0^2 - s1^2 + s2^2:
    printed = d[1] - 2 * s[0] * s[2] ** 2 * eta
    bracket = -s[0] * (s[0] ** 2 - s[1] ** 2 + s[2] ** 2) * eta
    right = -s[0] * (s[0] ** 2 - s[1] ** 2 - s[2] ** 2) * eta
    assert sympy.expand(printed - d[1] - (bracket - right)) == 0
    assert sympy.expand(cross[1] - printed) != 0
    J = s[0] * s[1] * s[2]
    alpha = 1 + rho * J
    beta = alpha + rho * (J + (s[0] ** 2 + s[1] ** 2) * e)
    eq67 = (
        alpha * (s[0] * s[2] + s[1] * e),
        alpha * (s[1] * s[2] + s[0] * e),
        e**2 - beta * s[2] ** 2,
    )
    ours = cubic_vector(s, e, 0, rho)
    assert [sympy.expand(x - y) for x, y in zip(eq67, ours, strict=True)] == [0, 0, 0]
