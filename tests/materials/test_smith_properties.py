"""Thresholds and properties of the energies of Smith et al. 2018."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from points import make

from fem_snh import materials
from fem_snh.errors import BadInput
from fem_snh.materials.invariants import SIGMA

pytestmark = pytest.mark.one_debian

NU = 0.3

# --- thresholds ----------------------------------------------------------------------------------


def in_numbers(energy):
    """Principal stresses and their derivatives at three stretches, by numpy."""
    rows = [[sympy.diff(p, s) for s in SIGMA] for p in energy.slopes]
    pieces = {"where": lambda x, a, b: a if x > 0 else b}
    call = sympy.lambdify(
        (*SIGMA, *energy.constants), (list(energy.slopes), rows), [pieces, "math"]
    )
    return lambda s: tuple(np.array(x) for x in call(*s, *energy.values))


@pytest.mark.parametrize("nu", [-0.5, -0.24, 0.0, 0.2, 0.3, 0.49, 0.4999])
def test_how_much_resistance_stvk_needs(nu):
    """Below the documented bound the state turned inside out is a minimum; at it, no longer."""
    mu, lam = 1.0, 2 * nu / (1 - 2 * nu)
    a = np.sqrt((2 * mu + 3 * lam) / (4 * mu + 3 * lam))
    bound = 864 * (mu + 1.5 * lam) * (1 - a**2) / (a * (1 + a**3) ** 2)
    assert bound < materials.defaults("stvk_kikuuwe")["kappa"]
    least = {}
    for factor in (0.99, 1.0, 1.01):
        x = a
        at = in_numbers(materials.make_energy("stvk_kikuuwe", nu=nu, kappa=factor * bound))
        for _ in range(30):  # Newton for P = 0 among the states (x, x, -x), from the bound's
            P, H = at((x, x, -x))
            x -= P[0] / (H[0, 0] + H[0, 1] - H[0, 2])
        assert at((x, x, -x))[0] == pytest.approx(0, abs=1e-12)
        least[factor] = np.linalg.eigvalsh(at((x, x, -x))[1])[0]
    assert least[0.99] > 1e-4
    assert least[1.0] == pytest.approx(0, abs=1e-9)
    assert least[1.01] < -1e-4


def by_clamping(s, mu, lam, limit=0.25):
    """The stress of stretches s0 >= s1 >= s2 that are brought to J = limit one after the other."""
    s = np.array(s)
    if s.prod() >= limit:
        return mu * s - (mu - lam * np.log(s.prod())) / s
    x, y, _ = s
    if x * y * y > limit:
        c = np.array([x, y, limit / (x * y)])
    elif x**3 > limit:
        c = np.array([x, np.sqrt(limit / x), np.sqrt(limit / x)])
    else:
        c = np.full(3, np.cbrt(limit))
    d, p = s - c, mu - lam * np.log(limit)
    return mu * s + p * (d / c**2 - 1 / c) + lam * (d / c).sum() / c


def test_filter_of_the_volume():
    """bound="J" is eq. 5 continued linearly from the surface J = sigma_f; continuous there."""
    m = make("filtered_neo_hookean", NU, bound="J")
    rng = np.random.default_rng(0)
    s = -np.sort(-rng.uniform(0, 2, (400, 3)) * rng.choice([0.2, 1], (400, 3)), axis=1)
    s[::2, 2] *= -1
    s = np.concatenate([s, [(0, 0, 0), (1, 0, 0), (0.5, 0.5, 0.5), (1, 1, 0.25), (1, 1, -1)]])
    expected = np.array([by_clamping(x, *m.lame) for x in s])
    found = np.diagonal(m.pk1(np.array([np.diag(x) for x in s])), axis1=1, axis2=2)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
    above = s.prod(axis=1) >= 0.25
    assert 20 < above.sum() < len(s) - 20
    plain = make("neo_hookean", NU).pk1(np.array([np.diag(x) for x in s[above]]))
    assert np.diagonal(plain, axis1=1, axis2=2) == pytest.approx(expected[above], rel=1e-11)
    with pytest.raises(BadInput, match="bound"):
        materials.make_energy("filtered_neo_hookean", bound="area")
