"""The rule that determines the constants of a material from E and nu."""

from __future__ import annotations

import importlib
import sys

import numpy as np
import pytest
import sympy

import fem_snh
from fem_snh.errors import BadInput
from fem_snh.materials import models
from fem_snh.materials.functions import SIGMA
from fem_snh.materials.parameters import TUNING
from fem_snh.materials.tuning import stretch_power

pytestmark = pytest.mark.one_debian

NU = 0.3
ALPHAS = [0.4, 0.5, 1.5, 2.0, 3.0, 3.7, 6.0]
UPRIGHT = np.array([(1.4, 0.9, 0.6), (3.4, 0.6, 0.5), (1.3, 1.3, 0.7), (1.2, 1.0, 0.15)])
INVERTED = np.array([(1.4, 0.9, -0.6), (1.2, 1.0, -0.01), (2.0, 0.05, -0.02), (3.0, 2.0, -1.5)])


def power(alpha: float, epsilon: float, order: int = 0):
    """The derivative of this order of g, in mpmath."""
    s = SIGMA[0]
    return sympy.lambdify(s, sympy.diff(stretch_power(s, alpha, epsilon), s, order), "mpmath")


# --- the rule for constants ----------------------------------------------------------------------


def test_three_constants_move_least():
    """Of all constants with the wanted stiffness those nearest to the defaults, by projection."""
    E, nu = 2.0, 0.3
    found = np.array(fem_snh.material("mooney_rivlin", E=E, nu=nu).expression.values)
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    M = np.array([[2, 2, 0], [-4 / 3, -4 / 3, 1]])
    start = E * np.array([0.125, 0.0417, 1.0])
    assert M @ found == pytest.approx([mu, lam], rel=1e-12)
    expected = start + np.linalg.lstsq(M, np.array([mu, lam]) - M @ start, rcond=None)[0]
    assert found == pytest.approx(expected, rel=1e-10)


def test_a_constant_can_be_pinned():
    m = fem_snh.material("mooney_rivlin", E=2.0, nu=0.3, C2=0.05)
    C1, C2, _ = m.expression.values
    assert C2 == 0.05
    assert 2 * (C1 + C2) == pytest.approx(m.lame[0], rel=1e-12)
    with pytest.raises(BadInput, match=r"expected 2\*C1 \+ 2\*C2 = 0\.769"):
        fem_snh.material("mooney_rivlin", E=2.0, nu=0.3, C1=0.1, C2=0.05)  # one left for two
    with pytest.raises(BadInput, match="it takes E, nu"):
        fem_snh.material("neo_hookean", mu=1.0)  # two constants are both solved for


COUNTS = {
    "one": ("def one(I1, I_C, mu):\n    'psi = ...'\n    return mu * (I_C - 2 * I1 + 3)\n"),
    "none": ("def none(I_C):\n    'psi = ...'\n    return I_C - 3\n"),
    "many": (
        "def many(I_C, II_C, J, C1, C2, lam):\n    'psi = ...'\n"
        "    return C1 * (I_C - 3) + C2 * (II_C - 3) + lam * (J - 1) ** 2\n"
    ),
}


@pytest.fixture
def counts(monkeypatch, tmp_path):
    for name, text in COUNTS.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.setattr(models, "__path__", [*models.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    yield
    for name in COUNTS:
        sys.modules.pop(f"fem_snh.materials.models.{name}", None)


def test_too_few_or_too_many_constants(counts):
    assert fem_snh.material("one", nu=0.0).lame == pytest.approx((0.5, 0))
    with pytest.raises(BadInput, match=r"one free constant, mu, and so nu = 0: give that nu"):
        fem_snh.material("one", nu=0.3)
    mixed = fem_snh.material("one", nu=0.3, lambda_part="stable_neo_hookean")
    F = np.diag([1.3, 0.9, -0.4])
    same = fem_snh.material("fixed_corotational", nu=0.3)
    assert mixed.energy(F) == pytest.approx(same.energy(F), rel=1e-11)
    with pytest.raises(BadInput, match="has no free constant"):
        fem_snh.material("none")
    with pytest.raises(BadInput, match=r"C1, C2, lam, to be fitted to E and nu: pin C1, C2, lam"):
        fem_snh.material("many", nu=0.3)
    assert fem_snh.material("many", nu=0.3, C2=0.01).expression.values[1] == 0.01


def test_tuning_is_documented():
    assert set(TUNING) == {"alpha", "alpha_mu", "alpha_lambda", "lambda_part", "epsilon"}


def test_prescribed_constants_that_contradict_the_modulus():
    """At E = 1e4 and nu = 0.49, mu_lame = 1e4 / 2.98 = 3355.704698 and 2 (C1 + C2) must be that."""
    message = (
        r"'mooney_rivlin' with C1 = 1000, C2 = 800.1 has the shear modulus 3600.2 Pa, "
        r"E and nu have 3355.704698 Pa: expected 2\*C1 \+ 2\*C2 = 3355.704698, "
        "or C1 or C2 without a value"
    )
    with pytest.raises(BadInput, match=message):
        fem_snh.material("mooney_rivlin", E=1e4, nu=0.49, C1=1e3, C2=800.1)
    with pytest.raises(BadInput, match="takes one alpha, and no lambda_part"):
        fem_snh.material(
            "mooney_rivlin", E=2.98, nu=0.49, C1=0.3, C2=0.2, lambda_part="neo_hookean"
        )
    with pytest.raises(BadInput, match=r"C1 = 1000, C2 = 677.852, kappa = 3 has no free constant"):
        fem_snh.material("mooney_rivlin", E=1e4, nu=0.49, C1=1e3, C2=677.852349, kappa=3.0)


def test_prescribed_constants_that_agree_with_the_modulus():
    """The third then follows from lambda_lame = kappa - 4/3 (C1 + C2)."""
    m = fem_snh.material("mooney_rivlin", E=1e4, nu=0.49, C1=1e3, C2=677.852349)
    lam = 1e4 * 0.49 / (1.49 * 0.02)
    assert m.constants[2] == pytest.approx(lam + 4 / 3 * 1677.852349, rel=1e-9)
    assert m.lame == pytest.approx((1e4 / 2.98, lam), rel=1e-9)
