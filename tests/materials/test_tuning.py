"""Tuning: the nonlinearity alpha, its extension below epsilon, and mixing."""

from __future__ import annotations

import functools

import mpmath
import numpy as np
import pytest
import sympy
from points import deformations, make, observed_order, vec

from fem_snh.materials.invariants import SIGMA
from fem_snh.materials.tuning import stretch_power

pytestmark = pytest.mark.one_debian

NU = 0.3
ALPHAS = [0.4, 0.5, 1.5, 2.0, 3.0, 3.7, 6.0]
UPRIGHT = np.array([(1.4, 0.9, 0.6), (3.4, 0.6, 0.5), (1.3, 1.3, 0.7), (1.2, 1.0, 0.15)])
INVERTED = np.array([(1.4, 0.9, -0.6), (1.2, 1.0, -0.01), (2.0, 0.05, -0.02), (3.0, 2.0, -1.5)])


@functools.cache
def power(alpha: float, epsilon: float, order: int = 0):
    """The derivative of this order of g, in mpmath."""
    s = SIGMA[0]
    return sympy.lambdify(s, sympy.diff(stretch_power(s, alpha, epsilon), s, order), "mpmath")


# --- the extension of s^alpha --------------------------------------------------------------------


@pytest.mark.parametrize("alpha", ALPHAS)
@pytest.mark.parametrize("epsilon", [0.02, 0.1, 0.5])
def test_the_power_goes_on_below_epsilon(alpha, epsilon):
    """s^alpha above; odd, increasing, onto; value and three derivatives continuous at epsilon."""
    g, slope = power(alpha, epsilon), power(alpha, epsilon, 1)
    with mpmath.workdps(40):
        for s in (epsilon * 1.01, 0.7, 1.0, 5.0):
            assert abs(g(mpmath.mpf(s)) / mpmath.mpf(s) ** mpmath.mpf(str(alpha)) - 1) < 1e-30
        for s in np.concatenate([np.linspace(1e-9, 2 * epsilon, 40), [1e-3, 10.0]]):
            low, high = sorted((1.0, alpha))
            value, change = g(s), slope(s)
            factor = change / (value / s)  # exactly alpha above, between 1 and alpha below
            assert low - 1e-12 <= factor <= high + 1e-12
            assert change > 0
            assert g(-s) == -value
            assert slope(-s) == change
        assert slope(mpmath.mpf(0)) > 0
        at = mpmath.mpf(str(epsilon))
        d = mpmath.mpf(10) ** -15
        for order in range(4):
            f = power(alpha, epsilon, order)
            size = max(abs(power(alpha, epsilon, k)(at)) * at ** (k - order) for k in range(5))
            assert abs(f(at + d) - f(at - d)) <= 1e-10 * size


# --- nonlinearity --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "alpha"),
    [("stable_neo_hookean", a) for a in (0.5, 1.5, 3.7)]
    + [("neo_hookean", 2.0), ("arap", 0.4), ("ogden", 2.0), ("seth_hill", 2.0)],
)
def test_equations_16_to_18(name, alpha):
    """Energy, stresses and their derivatives from those of the plain material at s^alpha."""
    m, plain = make(name, NU, alpha=alpha), make(name, NU)
    for s in UPRIGHT:
        t, power_1 = s**alpha, s ** (alpha - 1)
        F, G = np.diag(s), np.diag(t)
        assert m.energy(F) == pytest.approx(plain.energy(G) / alpha**2, rel=1e-11, abs=1e-14)
        p = np.diag(plain.pk1(G))
        assert np.diag(m.pk1(F)) == pytest.approx(power_1 * p / alpha, rel=1e-10, abs=1e-13)
        pick = np.ix_([0, 4, 8], [0, 4, 8])
        A = np.diag((alpha - 1) / alpha * s ** (alpha - 2) * p)
        A += np.outer(power_1, power_1) * plain.hessian(G)[pick]
        assert m.hessian(F)[pick] == pytest.approx(A, abs=1e-10 * abs(A).max())


def test_seth_hill_is_corotational_made_nonlinear():
    """Chen & Barbic, section 5: StVK is alpha = 2; Hencky's energy knows no alpha."""
    F = deformations(UPRIGHT)
    for n in (0.5, 1.5, -1.0):
        a = make("seth_hill", NU, n=abs(n)).energy(F)
        assert make("corotational", NU, alpha=abs(n)).energy(F) == pytest.approx(a, rel=1e-11)
    a = make("corotational", NU, alpha=2, epsilon=0).energy(F)
    assert a == pytest.approx(make("stvk", NU).energy(F), rel=1e-11)
    assert make("hencky", NU, alpha=2.3).energy(F) == pytest.approx(make("hencky", NU).energy(F))


@pytest.mark.parametrize(
    ("name", "alpha"),
    [(n, a) for n in ("stable_neo_hookean", "stable_fung") for a in (0.5, 1.5)]
    + [("stable_neo_hookean", 3.7)],
)
def test_inverted_elements(name, alpha):
    """Finite; energy, stress and Hessian of one another; no stationary state but rest."""
    m = make(name, NU, alpha=alpha)
    F = deformations(INVERTED, seed=4)
    assert m.expression.inversion_safe
    assert np.isfinite(m.energy(F)).all()
    h = 1e-3 * 2.0 ** -np.arange(6)
    for f in F:
        D = np.random.default_rng(1).standard_normal((3, 3))
        points = f + h[:, None, None] * D, f - h[:, None, None] * D
        up, down = (m.energy(x) for x in points)
        error = abs((up - down) / (2 * h) - (m.pk1(f) * D).sum())
        assert observed_order(h, error, 1e-15 / h) == pytest.approx(2, abs=0.3)
        up, down = (vec(m.pk1(x)) for x in points)
        error = np.linalg.norm((up - down) / (2 * h[:, None]) - m.hessian(f) @ vec(D), axis=1)
        floor = 1e-15 * np.linalg.norm(m.hessian(f)) / h
        assert observed_order(h, error, floor) == pytest.approx(2, abs=0.3)


# --- mixing --------------------------------------------------------------------------------------


def test_corotational_with_the_volume_of_another():
    """mu of corotational, lambda of (J - 1)^2: fixed_corotational (Chen & Barbic, section 6)."""
    F = deformations(np.concatenate([UPRIGHT, INVERTED]))
    mixed = make("corotational", NU, lambda_part="stable_neo_hookean")
    assert mixed.energy(F) == pytest.approx(make("fixed_corotational", NU).energy(F), rel=1e-11)
    assert mixed.expression.inversion_safe
    logs = make("corotational", NU, lambda_part="neo_hookean")
    mu, lam = logs.lame
    expected = mu * ((UPRIGHT - 1) ** 2).sum(1) + lam / 2 * np.log(UPRIGHT.prod(1)) ** 2
    assert logs.energy(F[: len(UPRIGHT)]) == pytest.approx(expected, rel=1e-11)
    assert np.isinf(logs.energy(F[len(UPRIGHT) :])).all()


def test_equation_20():
    """Each part with its own alpha."""
    mixed = make("stvk", NU, lambda_part="neo_hookean", alpha_mu=1.5, alpha_lambda=0.7)
    mu, lam = mixed.lame
    assert (mu, lam) == pytest.approx(make("stvk", NU).lame, rel=1e-12)
    a, b = UPRIGHT**1.5, np.log((UPRIGHT**0.7).prod(1))
    expected = mu / 1.5**2 * ((a**2 - 1) ** 2).sum(1) / 4 + lam / 0.7**2 / 2 * b**2
    assert mixed.energy(deformations(UPRIGHT)) == pytest.approx(expected, rel=1e-11)
    one, both = make("sts", NU, alpha_mu=2, alpha_lambda=2), make("sts", NU, alpha=2)
    F = deformations(UPRIGHT)
    assert one.energy(F) == pytest.approx(both.energy(F), rel=1e-11)
