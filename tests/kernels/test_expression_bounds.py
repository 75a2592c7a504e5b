"""Expressions that users write: those that are too large to evaluate, and powers of every kind."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest

import fem_snh
from fem_snh.errors import BadInput

NU = 0.3
#: Texts that sympy, given them as they are, expands or evaluates for hours, or C cannot hold.
TOO_LARGE = [
    ("1e999999999", "it cannot be read"),
    ("I_C * 1e-200", "a value is beyond 1e.100, or below its inverse"),
    ("9**9**9 * I_C", "an exponent is no number, or beyond 64"),
    ("(((((9**60)**60)**60)**60)**60)*I_C", "a value is beyond 1e.100"),
    ("((I_C - 3)**64 + 1)**64", "an exponent is no number, or beyond 64"),
    ("exp(1e6*I_C)", "a value is beyond 1e.100, or below its inverse"),
    ("(" * 300 + "I_C" + ")" * 300, "it cannot be read"),
    ("I_C" + " + I_C" * 300, "it has more than 1000 characters"),
    ("I_C.diff", "'I_C.diff' is not known"),
    ("I_C if J else 1", "'I_C if J else 1' is not known"),
]


@pytest.mark.parametrize(("text", "words"), TOO_LARGE, ids=[t[0][:40] for t in TOO_LARGE])
def test_expressions_too_large_to_evaluate(text: str, words: str) -> None:
    """One line, which begins with the key and the value."""
    with pytest.raises(BadInput, match=rf"^length = '.*{words}.*: expected an expression in I_C"):
        fem_snh.material("gamma_model", nu=NU, length=text)


@pytest.mark.one_debian
@pytest.mark.parametrize("power", ["1.37", "1.5", "(1/3)", "2.7182818284"])
def test_powers_of_the_invariant(power: str) -> None:
    """psi = mu f(I_C) + lam (J - 1)^2/2 - 2 mu f'(3) (J - 1), f = I_C^power, in 40 digits.

    mu_lame is the second derivative in s_0 minus that in s_0 and s_1, halved:
    mu (2 f'(3) + 4 f''(3) - 4 f''(3) + 2 f'(3))/2 = 2 mu f'(3), as J contributes -(-2 mu f')/2.
    """
    m = fem_snh.material("gamma_model", E=2.0, nu=NU, length=f"I_C**{power}")
    with mpmath.workdps(40):
        n = mpmath.mpf(1) / 3 if power == "(1/3)" else mpmath.mpf(power)
        mu_lame = mpmath.mpf(2) / (2 * (1 + mpmath.mpf("0.3")))
        slope = n * mpmath.mpf(3) ** (n - 1)
        mu = mu_lame / (2 * slope)
        lam_lame = mpmath.mpf(2) * mpmath.mpf("0.3") / (mpmath.mpf("1.3") * mpmath.mpf("0.4"))
        # lambda_lame, the mixed derivative: 4 mu f'' + lam - 2 mu f'.
        lam = lam_lame - 4 * mu * n * (n - 1) * mpmath.mpf(3) ** (n - 2) + 2 * mu * slope

        def psi(a, b, c):
            I_C, J = a**2 + b**2 + c**2, a * b * c
            value = mu * (I_C**n - mpmath.mpf(3) ** n) + lam * (J - 1) ** 2 / 2
            return value - 2 * mu * slope * (J - 1)

        stretches = (1.4, 0.9, 0.7)
        energy = float(psi(*map(mpmath.mpf, stretches)))
        stress = [
            float(mpmath.diff(psi, stretches, tuple(int(i == k) for i in range(3))))
            for k in range(3)
        ]
    F = np.diag(stretches)
    assert m.energy(F) == pytest.approx(energy, rel=1e-12)
    assert np.diag(m.pk1(F)) == pytest.approx(stress, rel=1e-9)
    assert m.lame == pytest.approx((float(mu_lame), float(lam_lame)), rel=1e-12)


@pytest.mark.parametrize(
    ("name", "keywords", "message"),
    [
        ("stable_neo_hookean", {"E": True}, r"E = True: expected a number from 1e-100 to 1e\+100"),
        ("stable_neo_hookean", {"E": np.bool_(True)}, "E = True: expected a number from"),
        ("stable_neo_hookean", {"E": "x"}, "E = 'x': expected a number from"),
        ("stable_neo_hookean", {"E": 1j}, "E = 1j: expected a number from"),
        ("stable_neo_hookean", {"nu": False}, r"nu = False: expected a number in \(-1, 0.5\]"),
        ("stable_neo_hookean", {"nu": "0.3"}, r"nu = '0.3': expected a number in \(-1, 0.5\]"),
        ("stable_neo_hookean", {"barrier": 3}, "barrier = 3: expected true or false"),
        ("stable_neo_hookean", {"alpha": True}, "alpha = True: expected a finite number"),
        ("stable_neo_hookean", {"lambda_part": 3}, "lambda_part = 3: expected the name of a mat"),
        ("mooney_rivlin", {"C1": "x"}, "C1 = 'x': expected a finite number"),
        ("mooney_rivlin", {"C1": True}, "C1 = True: expected a finite number"),
        ("gamma_model", {"length": 3}, "length = 3: expected a text"),
    ],
)
def test_values_of_the_wrong_type(name, keywords, message) -> None:
    """True is no number, neither in a program nor in a scene."""
    with pytest.raises(BadInput, match=f"^{message}"):
        fem_snh.material(name, **keywords)
