"""Energies that are special cases of others, errata of the papers, mistakes in parameters."""

from __future__ import annotations

import mpmath as mp
import numpy as np
import pytest
from points import make
from stretch_formulas import NU, STATES

pytestmark = pytest.mark.one_debian

# --- one family in another -----------------------------------------------------------------------

F = np.array([np.diag(s) for s in STATES])


@pytest.mark.parametrize(
    ("name", "shape", "same"),
    [
        ("seth_hill", {"n": 1}, "corotational"),
        ("seth_hill", {"n": 2}, "stvk"),
        ("hill", {"strain": "(s**2 - 1)/2"}, "stvk"),
        ("hill", {"strain": "s - 1"}, "corotational"),
        ("ogden", {"exponents": (2.0,), "weights": (1.0,)}, "neo_hookean_ogden"),
        ("ogden", {"exponents": (2.0,), "weights": (1.0,), "volume": "log"}, "neo_hookean"),
        ("arap", {"volume": "J"}, "fixed_corotational"),
        ("stable_arruda_boyce", {"betas": ()}, "gamma_model"),
        ("stable_fung", {"gamma": 0.0}, "gamma_model"),
        ("stvk_kikuuwe", {"kappa": 0.0}, "stvk"),
        ("sts", {"mu_4": 0.0}, "neo_hookean"),
        ("valanis_landel_xu", {"area": "0*a"}, "valanis_landel_new"),
        ("valanis_landel_new", {"length": "s**2/2", "volume": "(J-1)**2/2"}, "neo_hookean_ogden"),
        ("valanis_landel_new", {"volume": "log(J)**2/2"}, "valanis_landel"),
        ("gamma_model", {"length": "I_C"}, "gamma_model"),
        ("gamma_model", {"length": "I_C + exp((I_C - 3)/2)/10"}, "stable_fung"),
    ],
)
def test_special_cases(name, shape, same):
    one, other = make(name, NU, **shape), make(same, NU)
    assert one.energy(F) == pytest.approx(other.energy(F), rel=1e-10, abs=1e-13)
    assert one.pk1(F) == pytest.approx(other.pk1(F), rel=1e-9, abs=1e-11)


def test_equation_53_as_printed_is_stressed():
    """alpha = 1 + (mu_0 + gamma mu_1)/lambda leaves P(I) = -gamma mu_1/2 in its own constants."""
    m = make("stable_fung", NU)
    mu, lam = m.expression.values
    gamma, mu_1 = 0.1 * mu, 1.0

    def stress(alpha):
        return mu + gamma * mu_1 / 2 + lam * (1 - alpha)

    assert stress(1 + (mu + gamma * mu_1 / 2) / lam) == pytest.approx(0, abs=1e-15)
    assert stress(1 + (mu + gamma * mu_1) / lam) == pytest.approx(-gamma * mu_1 / 2, rel=1e-12)
    assert m.expression.rest_stress == pytest.approx(0, abs=1e-15)


def test_table_1_as_printed_ogden_is_stressed():
    """sum mu_p/a_p (sum s^a_p - 3) alone: P(I) = sum mu_p, which the logarithm takes away."""
    weights, exponents = (6.3, 0.012, -0.1), (1.3, 5.0, -2.0)
    slope = sum(w / a * a for w, a in zip(weights, exponents, strict=True))
    assert slope == pytest.approx(6.212)
    assert make("ogden", NU).expression.rest_stress == pytest.approx(0, abs=1e-14)


@pytest.mark.parametrize("name", ["gamma_model", "stable_fung", "stable_arruda_boyce"])
def test_equation_52(name):
    """gamma_I +- gamma_H s_i are the twists and flips: gammas from derivatives of the energy."""
    m = make(name, NU)
    for sigma in STATES:
        I_C, J = float(np.dot(sigma, sigma)), float(np.prod(sigma))
        h = 1e-6

        def psi(a, b):
            return float(m.expression.evaluate("mpmath", mp.mpf(a), mp.mpf(b)))

        gamma_I = 2 * (psi(I_C + h, J) - psi(I_C - h, J)) / (2 * h)
        gamma_H = (psi(I_C, J + h) - psi(I_C, J - h)) / (2 * h)
        values = m.eigensystem(np.diag(sigma))[0]
        s = np.sort(sigma)[::-1]
        assert values[3:6] == pytest.approx(gamma_I + gamma_H * s, abs=1e-7)
        assert values[6:9] == pytest.approx(gamma_I - gamma_H * s, abs=1e-7)
