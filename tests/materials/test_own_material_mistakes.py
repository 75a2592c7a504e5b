"""Functions that do not define a material: one line with the function and what is expected."""

from __future__ import annotations

import math

import pytest
import sympy
from sympy import Symbol, log

import fem_snh
from fem_snh import BadInput
from fem_snh.materials import PrincipalStress

pytestmark = pytest.mark.one_debian


def number(I_C, J, mu, lam):
    return 1.0


def raises(I_C, J, mu, lam):
    return mu * math.log(J) + lam * I_C


def foreign(I_C, J, mu, lam):
    return mu * (I_C - 3) + lam * (J - 1) ** 2 * Symbol("k")


def sine(I_C, J, mu, lam):
    return mu * (I_C - 3) - 2 * mu * sympy.sin(J - 1) + lam * (J - 1) ** 2


def exponent(I_C, J, mu, lam):
    return mu * (I_C - 3) + J**lam


def infinite(I_C, J, mu, lam, *, at=0):
    return mu * (I_C - 3) - 2 * mu * log(J) + lam * (J - 1) ** 2 / Symbol("at").subs("at", at)


def large_exponent(I_C, J, mu, lam):
    return mu * (I_C - 3) - 2 * mu * log(J) + lam * (J - 1) ** 1000


def stressed(I_C, J, mu, lam):
    return mu / 2 * (I_C - 3) + lam / 2 * (J - 1) ** 2


def unknown_measure(I_1, J, mu, lam):
    return mu / 2 * (I_1 - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def constant_first(mu, I_C, J, lam):
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def no_measure(mu, lam):
    return mu + lam


def of_anything(*arguments):
    return arguments[0]


def taken(I_C, J, mu, lam, *, alpha=1.0):
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def no_default(I_C, J, mu, lam, *, k):
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2


def no_constant(I_C, J):
    return (I_C - 3) / 2 - log(J)


def three_constants(I_C, J, a, b, c):
    return a / 2 * (I_C - 3) - a * log(J) + b / 2 * log(J) ** 2 + c * (J - 1) ** 2


def anisotropic(s0, s1, s2, mu, lam):
    return mu * ((s0 - 1) ** 2 + 2 * (s1 - 1) ** 2) + lam / 2 * (s0 + s1 + s2 - 3) ** 2


def anisotropic_stress(s0, s1, s2, mu, lam):
    trace = lam * (s0 + s1 + s2 - 3)
    return PrincipalStress(
        *(k * mu * (s - 1) + trace for k, s in zip((2, 2, 3), (s0, s1, s2), strict=True))
    )


MISTAKES = [
    (number, r"its function returns 1.0: expected a sympy expression in I_C, J"),
    (raises, r"its function fails: TypeError: .*expected sympy's"),
    (foreign, r"unknown symbol k: expected"),
    (sine, r"function sin: expected .*log, exp, sqrt"),
    (exponent, r"exponent lam in J\*\*lam: expected a number"),
    (infinite, r"its function returns .*: expected an expression that is real and finite"),
    (large_exponent, r"exponent 1000: expected a number from -64 to 64"),
    (stressed, r"stress 0.769 E at rest .F = I.: expected"),
    (unknown_measure, r"argument 'I_1': expected a measure among I_C .tr C."),
    (constant_first, r"argument 'mu': expected a measure among .*; the constants follow"),
    (no_measure, r"expected an argument that is a measure: I_C"),
    (of_anything, r"argument 'arguments': expected measures"),
    (taken, r"argument 'alpha': expected another name"),
    (no_default, r"shape parameter 'k': expected a default"),
    (no_constant, r"has no free constant"),
    (three_constants, r"has the free constants a, b, c, .*: pin a, b, c or give defaults"),
    (anisotropic_stress, r"is not symmetric in s0, s1, s2: expected p1 to be p0 with s0 and s1"),
    (anisotropic, r"is not symmetric in s0, s1, s2: expected an isotropic energy"),
]


@pytest.mark.parametrize(("function", "message"), MISTAKES, ids=[f.__name__ for f, _ in MISTAKES])
def test_mistakes_in_functions(function, message):
    with pytest.raises(BadInput, match=f"^material '{function.__name__}'.*{message}") as caught:
        fem_snh.material(function, nu=0.3)
    assert "\n" not in str(caught.value)
