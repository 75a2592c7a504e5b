"""The claims of Smith et al. 2018 about the stability of the stable Neo-Hookean energy."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import sympy
from points import make

from fem_snh.kernels.reports import stability
from fem_snh.materials.invariants import SIGMA

pytestmark = pytest.mark.one_debian


# --- the paper's claims about stable Neo-Hookean -------------------------------------------------

SNH = [(nu, barrier) for nu in (0.0, 0.3, 0.45, 0.49) for barrier in (True, False)]
snh = pytest.mark.parametrize("m", [make("stable_neo_hookean", nu, barrier=b) for nu, b in SNH],
                              ids=[f"{nu}-{'eq14' if b else 'eq13'}" for nu, b in SNH])  # fmt: skip


@snh
def test_stable_neo_hookean_is_inversion_rest_and_reflection_stable(m):
    four = stability.inversion(m), stability.reflection(m), stability.rest(m)
    assert [s.verdict for s in four] == ["passed"] * 3, four
    assert four[1].numbers == pytest.approx(dict.fromkeys(four[1].numbers, 0), abs=1e-13)
    assert four[2].numbers == pytest.approx(dict.fromkeys(four[2].numbers, 0), abs=1e-14)


@snh
def test_crushed_to_a_plane_it_is_pushed_back_along_the_normal(m):
    mu, lam = m.constants
    a, b = 1.3, 0.6
    alpha = 1 + (0.75 if m.expression.shape["barrier"] else 1) * mu / lam
    P = m.pk1(np.diag([a, b, 0.0]))
    assert P[2, 2] == pytest.approx(-lam * alpha * a * b)
    assert stability.degeneracy(m).numbers["plane force"] < 0


@snh
def test_crushed_to_a_point(m):
    """Eq. 13 is positive definite there, eq. 14 exactly semidefinite (delta = 1)."""
    mu = m.constants[0]
    assert np.all(m.pk1(np.zeros((3, 3))) == 0)
    values = np.linalg.eigvalsh(m.hessian(np.zeros((3, 3))))
    found = stability.degeneracy(m)
    if m.expression.shape["barrier"]:
        assert np.all(np.abs(values) <= 1e-15 * mu)
        assert found.verdict == "passed"
    else:
        assert values == pytest.approx(mu)
        assert found.verdict == "failed" and found.reason.endswith("point")


@lru_cache
def threshold() -> float:
    """lambda/mu of eq. 14 below which a second minimum appears under uniform scaling.

    dpsi/ds over its trivial roots s^2 (s - 1) is a quartic; where its discriminant vanishes two
    more stationary points are born.
    """
    name = make("stable_neo_hookean", -0.8, barrier=True).expression
    s, r = sympy.symbols("s r", positive=True)
    mu, lam = name.constants
    along = name.psi_sigma.subs(dict.fromkeys(SIGMA, s)).subs({mu: 1, lam: r})
    slope = sympy.numer(sympy.together(sympy.diff(along, s)))
    quartic, rest = sympy.div(sympy.Poly(slope, s), sympy.Poly(s**2 * (s - 1), s))
    assert rest == 0 and quartic.degree() == 4
    born = []
    for root in sympy.real_roots(sympy.Poly(sympy.discriminant(quartic), r)):
        double = [
            x for x in np.roots([float(c.subs(r, root)) for c in quartic.all_coeffs()])
            if abs(x.imag) < 1e-4 and x.real > 0
        ]  # fmt: skip
        if root > 0 and double:
            born.append(float(root))
    return max(born)


def test_no_spurious_minima_above_0_1525():
    """0.152568..., of which the paper prints the first four digits."""
    assert threshold() == pytest.approx(0.15256826, abs=1e-8)
    assert int(threshold() * 1e4) == 1525
