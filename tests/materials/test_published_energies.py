"""Energies and stresses against the published formulas in the principal stretches."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from points import make
from stretch_formulas import NU, STATES, areas, green, strains, sums

pytestmark = pytest.mark.one_debian


def ogden(s, mu, lam):
    exponents, weights = (1.3, 5.0, -2.0), (6.3, 0.012, -0.1)
    scale = mu / (sum(w * a for w, a in zip(weights, exponents, strict=True)) / 2)
    J = sums(s)[2]
    terms = (
        scale * w * (sum(x**a for x in s) - 3) / a for w, a in zip(weights, exponents, strict=True)
    )
    return sum(terms) - scale * sum(weights) * mp.log(J) + lam / 2 * (J - 1) ** 2


#: psi(s; mu_lame, lambda_lame) of each material with its default shape, as published and completed.
SMITH = {
    "stable_neo_hookean": lambda s, m, k: (  # eq. 14: mu = 4/3 m, lambda = k + 5/6 m
        2 * m / 3 * (sums(s)[1] - 3)
        + (k + 5 * m / 6) / 2 * (sums(s)[2] - 1 - m / (k + 5 * m / 6)) ** 2
        - 2 * m / 3 * mp.log(sums(s)[1] + 1)
    ),
    "neo_hookean": lambda s, m, k: (
        m / 2 * (sums(s)[1] - 3) - m * mp.log(sums(s)[2]) + k / 2 * mp.log(sums(s)[2]) ** 2
    ),
    "neo_hookean_ogden": lambda s, m, k: (
        m / 2 * (sums(s)[1] - 3) - m * mp.log(sums(s)[2]) + k / 2 * (sums(s)[2] - 1) ** 2
    ),
    "neo_hookean_bower": lambda s, m, k: (
        m / 2 * (sums(s)[2] ** (-2 / mp.mpf(3)) * sums(s)[1] - 3)
        + (k + 2 * m / 3) / 2 * (sums(s)[2] - 1) ** 2
    ),
    "neo_hookean_simo": lambda s, m, k: (
        m / 2 * (sums(s)[2] ** (-2 / mp.mpf(3)) * sums(s)[1] - 3)
        + (k + 2 * m / 3) / 4 * (sums(s)[2] ** 2 - 1 - 2 * mp.log(sums(s)[2]))
    ),
    "neo_hookean_ciarlet": lambda s, m, k: (
        m / 2 * (sums(s)[1] - 3 - 2 * mp.log(sums(s)[2]))
        + k / 4 * (sums(s)[2] ** 2 - 1 - 2 * mp.log(sums(s)[2]))
    ),
    "neo_hookean_wang": lambda s, m, k: (  # mu = m + lambda/4, k = lambda/2 - 2/3 mu
        (m + (k + 2 * m / 3) * 3 / 4) / 2 * (sums(s)[2] ** (-2 / mp.mpf(3)) * sums(s)[1] - 3)
        + (k + 2 * m / 3) * 3 / 2 * (sums(s)[2] - 1)
    ),
    "mooney_length": lambda s, m, k: m * (sums(s)[1] - 3) + k / 2 * (sums(s)[2] - 1) ** 2,
    "corotational": strains(lambda x: x - 1),
    "fixed_corotational": lambda s, m, k: (
        m * sum((x - 1) ** 2 for x in s) + k / 2 * (sums(s)[2] - 1) ** 2
    ),
    "stvk": lambda s, m, k: m * sum(e**2 for e in green(s)) + k / 2 * sum(green(s)) ** 2,
    "stvk_kikuuwe": lambda s, m, k: (
        m * sum(e**2 for e in green(s))
        + k / 2 * sum(green(s)) ** 2
        + 400 * m / 12 * (max(0, 1 - sums(s)[2]) / 6) ** 3
    ),
    "stable_fung": lambda s, m, k: hardened(s, m, k),
    "stable_arruda_boyce": lambda s, m, k: hardened(s, m, k, fung=False),
    "gamma_model": lambda s, m, k: (  # eq. 13
        m / 2 * (sums(s)[1] - 3) - m * (sums(s)[2] - 1) + (k + m) / 2 * (sums(s)[2] - 1) ** 2
    ),
}


def hardened(s, m, k, fung=True):
    """Eq. 53 and 58 with alpha from P(I) = 0, and mu, lambda solved for numerically."""
    _, I_C, J = sums(s)

    def psi(I_C, J, mu, lam):
        if fung:
            gamma, mu_1 = mu / 10, 1
            alpha = 1 + (mu + gamma * mu_1 / mp.mpf(2)) / lam  # not (mu + gamma mu_1)/lam
            extra = gamma / 2 * (mp.exp(mu_1 * (I_C - 3) / 2) - 1)
        else:
            b1, b2 = mp.mpf("0.025"), mp.mpf(11) / 11200
            alpha = 1 + mu / lam * (1 + 3 * b1 + 9 * b2)
            extra = mu * b1 / 4 * (I_C**2 - 9) + mu * b2 / 6 * (I_C**3 - 27)
        return mu / 2 * (I_C - 3) + extra + lam / 2 * (J - alpha) ** 2

    def moduli(mu, lam):

        def f(a, b):
            return psi(a**2 + b**2 + 1, a * b, mu, lam)

        a, b = mp.diff(f, (1, 1), (2, 0)), mp.diff(f, (1, 1), (1, 1))
        return (a - b) / 2 - m, b - k

    mu, lam = mp.findroot(moduli, (m, k + m))
    return psi(I_C, J, mu, lam)


CHEN_BARBIC = {
    "hencky": strains(mp.log),
    "hill": strains(mp.log),
    "seth_hill": strains(lambda x: (mp.sqrt(x) - 1) / mp.mpf("0.5")),
    "symmetric_seth_hill": strains(lambda x: (x - 1 / x) / 2),
    "sts": lambda s, m, k: SMITH["neo_hookean"](s, m, k) + m / 8 * sum((x**2 - 1) ** 4 for x in s),
    "valanis_landel": lambda s, m, k: (
        2 * m * sum(x * (mp.log(x) - 1) for x in s) + k / 2 * mp.log(sums(s)[2]) ** 2
    ),
    "valanis_landel_new": lambda s, m, k: (
        2 * m * sum(x * (mp.log(x) - 1) for x in s) + k / 2 * (sums(s)[2] - 1) ** 2
    ),
    "valanis_landel_xu": lambda s, m, k: (  # f'' = 1, g'' = 1/4: m = c (1 + 1/4)/2, k = l + c/4
        8 * m / 5 * sum(x * (mp.log(x) - 1) for x in s)
        + 8 * m / 5 / 4 * sum(a * (mp.log(a) - 1) for a in areas(s))
        + (k - 8 * m / 5 / 4) / 2 * (sums(s)[2] - 1) ** 2
    ),
    "peng_landel": lambda s, m, k: (
        3 * m * sum(x - 1 - (t := mp.log(x)) - t**2 / 6 + t**3 / 18 - t**4 / 216 for x in s)
        + k / 2 * (sums(s)[2] - 1) ** 2
    ),
    "arap": lambda s, m, k: SMITH["fixed_corotational"](s, m, k),
    "symmetric_arap": lambda s, m, k: (
        m / 2 * sum((x - 1) ** 2 + (1 - 1 / x) ** 2 for x in s) + k / 2 * (sums(s)[2] - 1) ** 2
    ),
    "symmetric_dirichlet": lambda s, m, k: (
        m / 4 * sum((x - 1 / x) ** 2 for x in s) + k / 2 * (sums(s)[2] - 1) ** 2
    ),
    "ogden": ogden,
}
PUBLISHED = SMITH | CHEN_BARBIC


@pytest.mark.parametrize("name", PUBLISHED)
def test_energy_and_stress(name):
    """Energy less that at rest, and principal stresses by mpmath's derivative."""
    m = make(name, NU)
    psi, lame = PUBLISHED[name], [mp.mpf(x) for x in m.lame]
    with mp.workdps(30):
        rest = psi([mp.mpf(1)] * 3, *lame)
        for sigma in STATES:
            s = [mp.mpf(x) for x in sigma]
            assert float(psi(s, *lame) - rest) == pytest.approx(
                float(m.energy(np.diag(sigma))), rel=1e-11, abs=1e-13
            )
            slopes = [
                mp.diff(lambda x, i=i: psi([*s[:i], x, *s[i + 1 :]], *lame), s[i]) for i in range(3)
            ]
            found = np.diag(m.pk1(np.diag(sigma)))
            assert found == pytest.approx(np.array(slopes, dtype=float), rel=1e-9, abs=1e-10)


def test_filtered_neo_hookean():
    """Eq. 5's stress above the threshold; below it only mu s changes, and the rest is as at it."""
    m, plain = make("filtered_neo_hookean", NU), make("neo_hookean", NU)
    for sigma in STATES:
        F = np.diag(sigma)
        assert m.pk1(F) == pytest.approx(plain.pk1(F), rel=1e-12, abs=1e-14)
    at = plain.pk1(np.diag([1.2, 1.1, 0.25]))
    for s in (0.25, 0.1, 0.0, -0.5, -1.0):
        P = m.pk1(np.diag([1.2, 1.1, s]))
        expected = at + np.diag([0, 0, m.lame[0] * (s - 0.25)])
        assert P == pytest.approx(expected, rel=1e-12, abs=1e-13)


def test_c2_neo_hookean():
    """Eq. 5 above J = threshold; two derivatives continuous there, finite and convex in J below."""
    m, plain = make("c2_neo_hookean", NU), make("neo_hookean", NU)
    for sigma in STATES:
        if np.prod(sigma) >= 0.4:
            assert m.energy(np.diag(sigma)) == pytest.approx(
                plain.energy(np.diag(sigma)), rel=1e-12
            )
    above, below = (np.diag([1.0, 1.0, 0.4 + d]) for d in (1e-9, -1e-9))
    assert m.energy(above) == pytest.approx(m.energy(below), rel=1e-7)
    assert m.pk1(above) == pytest.approx(m.pk1(below), abs=1e-7)
    assert m.hessian(above) == pytest.approx(m.hessian(below), abs=1e-6)
    assert np.isfinite(m.energy(np.diag([1.5, 1.0, -2.0])))
