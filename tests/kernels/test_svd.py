"""The rotation-variant SVD of kernels/include/svd.h."""

from __future__ import annotations

from fractions import Fraction

import hypothesis.strategies as st
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis.extra.numpy import arrays
from points import KINDS, deformations, every_kind, rotations

from fem_snh.kernels.material import svd

pytestmark = pytest.mark.one_debian


def exact_determinants(F: np.ndarray) -> np.ndarray:
    """Return det F (...) in rational arithmetic: elimination in double precision may overflow."""
    found = []
    for row in F.reshape(-1, 9).tolist():
        a, b, c, d, e, f, g, h, i = map(Fraction, row)
        found.append(float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)))
    return np.reshape(found, F.shape[:-2])


def check(F: np.ndarray) -> None:
    """Everything that the SVD of finite F (..., 3, 3) promises."""
    U, s, V = svd(F)
    eye = np.eye(3)
    # Entries scaled so that squares neither overflow nor underflow; denormals have fewer digits.
    size = abs(F).max(axis=(-2, -1), keepdims=True)
    size = np.where(size > 0, 2.0 ** np.floor(np.log2(np.where(size > 0, size, 1))), 1)
    error = (U * (s[..., None, :] / size)) @ np.swapaxes(V, -1, -2) - F / size
    assert abs(error).max() <= 1e-14 + 4 * (5e-324 / size).max()
    for Q in (U, V):
        assert abs(np.swapaxes(Q, -1, -2) @ Q - eye).max() <= 4e-15
        assert abs(np.linalg.det(Q) - 1).max() <= 1e-14
    slack = 1e-14 * s[..., 0]
    assert np.all(s[..., 0] >= s[..., 1] - slack)
    assert np.all(s[..., 1] >= abs(s[..., 2]) - slack)
    J = exact_determinants(F / size)
    sure = abs(J) > 1e-13
    assert np.all(np.sign(s[..., 2])[sure] == np.sign(J)[sure])


@every_kind
def test_reconstruction_order_and_signs(kind):
    check(deformations(KINDS[kind]))
    check(KINDS[kind][:, :, None] * np.eye(3))


@given(arrays(float, (3, 3), elements=st.floats(-1e300, 1e300)))
def test_any_matrix(F):
    check(F)


@given(
    arrays(float, (3, 3), elements=st.sampled_from([0.0, 1.0, -1.0, 2.0, 1e-160, 1e-80, 1e-300]))
)
def test_dependent_columns(F):
    """Rank 0, 1 and 2, also where the parts that matter are too small to be squared."""
    check(F)


@pytest.mark.parametrize("side", ["columns", "rows"])
def test_small_stretches_keep_their_digits(side):
    """High relative accuracy where F gives it: rotations times columns (or rows) of any size."""
    rng = np.random.default_rng(5)
    Q, D = rotations(40, 6), np.sort(10.0 ** rng.uniform(-10, 10, (40, 3)))[:, ::-1]
    B = Q + 0.2 * rng.standard_normal(Q.shape)  # well-conditioned, no rotation
    F = B * D[:, None, :] if side == "columns" else B * D[:, :, None]
    _, s, _ = svd(F)
    worst = 0.0
    with mpmath.workdps(60):
        for f, found in zip(F, s, strict=True):
            true = mpmath.svd_r(mpmath.matrix(f.tolist()), compute_uv=False)
            sign = mpmath.sign(mpmath.det(mpmath.matrix(f.tolist())))
            for k in range(3):
                exact = true[k] * (sign if k == 2 else 1)
                worst = max(worst, float(abs(found[k] / exact - 1)))
    assert worst <= 1e-13


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_not_finite(bad):
    F = np.tile(np.eye(3), (9, 1, 1))
    F[4, 1, 2] = bad
    U, s, V = svd(F)
    assert np.isnan(s[4]).all()
    assert np.array_equal(U[4], np.eye(3))
    assert np.array_equal(V[4], np.eye(3))
    check(np.delete(F, 4, axis=0))  # its neighbours do not notice
    assert np.isfinite(np.delete(s, 4, axis=0)).all()


def test_a_determinant_that_elimination_does_not_find():
    """Its entries differ by 300 orders of magnitude; by hand it is 1 + 1e-300."""
    F = np.array([[1e-300, 1e-300, 1.0], [2.0, 1.0, 0.0], [1.0, 1.0, -1.0]])
    assert exact_determinants(F) == 1.0
    check(F)
