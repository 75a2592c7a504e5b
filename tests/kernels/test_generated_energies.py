"""The code generator with energies that no material has: of stretches, real powers, I1, II_C."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
import sympy
from points import (
    KINDS,
    STATES,
    assert_eigenvalues,
    deformations,
    every_kind,
    filtered,
    is_outside_domain,
    make,
    observed_order,
    spread,
    vec,
)

from fem_snh.choices import FILTERS
from fem_snh.kernels.material import Material, svd
from fem_snh.materials.construction import construct

pytestmark = pytest.mark.one_debian


def neo_by_stretches(s0, s1, s2, mu, lam):
    J = s0 * s1 * s2
    return mu / 2 * (s0**2 + s1**2 + s2**2 - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2


def barrier_by_stretches(s0, s1, s2, mu, lam):
    J, I_C = s0 * s1 * s2, s0**2 + s1**2 + s2**2
    alpha = 1 + sympy.Rational(3, 4) * mu / lam
    return mu / 2 * (I_C - 3) + lam / 2 * (J - alpha) ** 2 - mu / 2 * sympy.log(I_C + 1)


def hencky(s0, s1, s2, mu, lam):
    logs = [sympy.log(s) for s in (s0, s1, s2)]
    return mu * sum(x**2 for x in logs) + lam / 2 * sum(logs) ** 2


def ogden(s0, s1, s2, mu, lam):
    """A real power; the term in J makes the rest state stress-free."""
    p = sympy.Rational(7, 2)
    J = s0 * s1 * s2
    return mu * sum(s**p - 1 for s in (s0, s1, s2)) - p * mu * sympy.log(J) + lam * (J - 1) ** 2


def corotational(I1, I_C, mu, lam):
    """Nonlinear in I1."""
    return mu * (I_C - 2 * I1 + 3) + lam / 2 * (I1 - 3) ** 2


def mooney(I_C, II_C, J, mu, lam):
    return mu * (I_C - 3) + mu / 3 * (II_C - 3) - 10 * mu / 3 * sympy.log(J) + lam * (J - 1) ** 2


def second_alone(II_C, J, mu, lam):
    return mu / 4 * (II_C - 3) ** 2 + mu * (II_C - 3) - 4 * mu * (J - 1) + lam / 2 * (J - 1) ** 2


def all_four(I1, I_C, II_C, J, mu, lam):
    return mu * (I_C + I1 * II_C / 3 - J * I_C * I1) + lam * (J - 1) ** 2 + 8 * mu * (J - 1)


ENERGIES = [neo_by_stretches, barrier_by_stretches, hencky, ogden]
ENERGIES += [corotational, mooney, second_alone, all_four]
each_energy = pytest.mark.parametrize("function", ENERGIES, ids=lambda f: f.__name__)


@lru_cache
def make_material(function, nu: float = 0.3) -> Material:
    return Material.of(construct(function, function.__name__, 1.7, nu, {}, {}, {}))


@pytest.mark.parametrize(
    ("function", "barrier"), [(neo_by_stretches, False), (barrier_by_stretches, True)]
)
@every_kind
def test_by_stretches_or_by_invariants_is_the_same(function, barrier, kind):
    """The same energy through both forms of generated code, nearly equal stretches included."""
    a, b = make_material(function), make("stable_neo_hookean", 0.3, barrier=barrier)
    F = deformations(KINDS[kind], seed=8)
    if kind.startswith("signed"):  # a rotation would lose J in the rounding of F
        F = KINDS[kind][:, :, None] * np.eye(3)
    assert a.energy(F) == pytest.approx(b.energy(F), rel=1e-12, abs=1e-13)
    size = np.linalg.norm(F, axis=(1, 2)) * spread(b.hessian(F)) + np.linalg.norm(b.pk1(F))
    assert np.all(abs(a.pk1(F) - b.pk1(F)) <= 1e-13 * size[:, None, None])
    for filter in FILTERS:
        H = b.hessian(F, filter)
        size = spread(b.hessian(F))[:, None, None]
        assert np.all(abs(a.hessian(F, filter) - H) <= 1e-9 * size)


@each_energy
@pytest.mark.parametrize(
    "sigma",
    [
        *[s for s in STATES.values() if min(s) > 0],
        (2.0, 1.2, -0.5),
        (1.0, 1.0, 1.0),
        (1.5, 1.5, 0.7),
        *[(1.3 + d, 1.3, 0.7) for d in (1e-2, 1e-3, 1e-4, 1e-5, 2e-5, 3e-6, 1e-7, 1e-10, 1e-15)],
    ],
)
def test_divided_differences_and_their_limits(function, sigma):
    """Ten digits where the division by s_j - s_k would leave none."""
    m = make_material(function)
    F = np.diag(sigma)
    if not is_outside_domain(m, F):
        assert_eigenvalues(m, svd(F)[1], m.eigensystem(F)[0], 1e-10)


@each_energy
def test_derivatives_filters_and_rest_state(function):
    m = make_material(function)
    F = deformations([1.4, 0.9, 0.6], seed=1)
    D = np.random.default_rng(8).standard_normal((3, 3)) / 3
    h = 0.02 * 2.0 ** -np.arange(8)
    up, down = (m.energy(F + x[:, None, None] * D) for x in (h, -h))
    error = abs((up - down) / (2 * h) - (m.pk1(F) * D).sum())
    size = abs(m.energy(F)) + np.linalg.norm(m.pk1(F)) * 2
    assert observed_order(h, error, 1e-16 * size / h) == pytest.approx(2, abs=0.15)
    up, down = (vec(m.pk1(F + x[:, None, None] * D)) for x in (h, -h))
    error = np.linalg.norm((up - down) / (2 * h[:, None]) - m.hessian(F) @ vec(D), axis=1)
    size = np.linalg.norm(m.hessian(F)) * 2
    assert observed_order(h, error, 1e-16 * size / h) == pytest.approx(2, abs=0.15)
    assert m.lame == pytest.approx(make("neo_hookean", 0.3).lame, rel=1e-10)
    F = deformations(np.random.default_rng(2).uniform(-2, 2, (200, 3)))
    H = m.hessian(F)
    size = spread(H)[:, None, None]
    assert np.all(abs(m.hessian(F, "clamp") - filtered(H, "clamp")) <= 1e-14 * size)
