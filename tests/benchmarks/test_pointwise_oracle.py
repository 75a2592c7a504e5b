"""The mpmath oracle of the pointwise study, against derivations that do not use it."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import sympy
from points import compare, every_name, exact, make

from benchmarks.point_bounds import exactly, filtered, norm
from fem_snh.kernels.material import Material

pytestmark = pytest.mark.one_debian


def mp(A) -> mpmath.matrix:
    return mpmath.matrix(np.asarray(A, dtype=object).tolist())


SAMPLE = [[1.3, 0.2, -0.4], [0.1, 0.8, 0.3], [0.25, -0.6, 1.1]]
INVERTED = [[1.3, 0.2, -0.4], [0.1, -0.8, 0.3], [0.25, -0.6, 1.1]]


@pytest.mark.parametrize("F", [SAMPLE, INVERTED])
def test_oracle_against_stable_neo_hookean_by_hand(F):
    """Energy, stress and Hessian of eq. 13 without a stretch: F, cof F and dcof F/dF."""
    m = make("stable_neo_hookean", 0.45)
    with mpmath.workdps(90):
        f = exactly(F)
        point = exact(m, f)
        mu, lam = map(mpmath.mpf, m.expression.values)
        cof = np.stack([np.cross(f[:, (j + 1) % 3], f[:, (j + 2) % 3]) for j in range(3)], axis=1)
        J = f[:, 0] @ cof[:, 0]
        psi = mu / 2 * ((f * f).sum() - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2
        assert abs(point.energy - psi) < mpmath.mpf(10) ** -80
        pressure = lam * (J - 1) - mu
        assert norm(point.P - (mu * f + pressure * cof)) < mpmath.mpf(10) ** -80
        H = mu * exactly(np.eye(9)) + lam * np.outer(cof.T.ravel(), cof.T.ravel())
        cross = np.array(
            [
                [[float(sympy.LeviCivita(i, j, k)) for k in range(3)] for j in range(3)]
                for i in range(3)
            ]
        )
        for i, a, j, b in np.ndindex(3, 3, 3, 3):  # d2J / dF_ia dF_jb
            total = sum(cross[i, j, k] * cross[a, b, c] * f[k, c] for k, c in np.ndindex(3, 3))
            H[3 * a + i, 3 * b + j] += pressure * total
        assert norm(point.hessian() - H) < mpmath.mpf(10) ** -80


@every_name
def test_oracle_against_mpmath_derivatives(name):
    """P is the derivative of the energy, and the Hessian that of P, by differences in 90 digits."""
    m = make(name, 0.3)
    with mpmath.workdps(90):
        f, h, A = (
            exactly(SAMPLE),
            mpmath.mpf(10) ** -20,
            exactly(np.arange(9).reshape(3, 3) / 8 - 0.4),
        )
        up, down, point = exact(m, f + h * A), exact(m, f - h * A), exact(m, f)
        tiny = mpmath.mpf(10) ** -35 * norm(point.hessian())
        if m.expression.has_energy:
            assert abs((up.energy - down.energy) / (2 * h) - (point.P * A).sum()) < tiny
        change = ((up.P - down.P) / (2 * h)).T.ravel()
        assert norm(change - point.hessian() @ A.T.ravel()) < tiny


@pytest.mark.parametrize("F", [SAMPLE, INVERTED, np.diag([1.0, 1.0, 0.2]), np.diag([3.0, 2, -1])])
@pytest.mark.parametrize("name", ["stable_neo_hookean", "fixed_corotational", "stvk"])
def test_oracle_against_a_dense_eigendecomposition(name, F):
    """Filters and eigenvalues by mpmath's eigsy of the 9x9 Hessian itself."""
    m = make(name, 0.45)
    with mpmath.workdps(90):
        point = exact(m, np.array(F))
        H = point.hessian()
        tiny = mpmath.mpf(10) ** -70
        assert norm(H - H.T) < tiny
        for filter in ("clamp", "abs"):
            assert norm(filtered(H, filter) - point.hessian(filter)) < tiny
        values = mpmath.eigsy(mp(H), eigvals_only=True)
        assert norm(np.array(list(values)) - np.array(point.eigenvalues)) < tiny


def test_a_wrong_kernel_is_found():
    """The bounds are no formality: a modulus off by 1e-12 breaks them."""
    m = make("neo_hookean", 0.3)
    wrong = Material.of(m.expression)
    wrong.constants = m.constants * (1 + 1e-12)
    rng = np.random.default_rng(0)
    found = {c.quantity: c.ratio for c in compare(wrong, np.array(SAMPLE), rng)}
    right = {c.quantity: c.ratio for c in compare(m, np.array(SAMPLE), rng)}
    assert max(right.values()) < 0.1
    assert found["energy"] > 1 and found["pk1"] > 1 and found["hessian clamp, cubic"] > 1
