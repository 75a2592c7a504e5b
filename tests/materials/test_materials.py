"""The registry of materials, and what normalisation promises of every one of them."""

from __future__ import annotations

import importlib
import sys

import mpmath
import numpy as np
import pytest
import sympy
from points import deformations, every_material, every_name, make, vec

import fem_snh
from fem_snh import materials
from fem_snh.errors import BadInput
from fem_snh.materials import models

pytestmark = pytest.mark.one_debian


def hooke(E: float, nu: float) -> np.ndarray:
    """Linear elasticity d(sigma)/d(grad u), (9, 9): 2 mu eps + lambda tr(eps) I."""
    mu, lam = E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))
    eye = np.eye(3)
    C = lam * np.einsum("ij,kl->ijkl", eye, eye)
    C += mu * (np.einsum("ik,jl->ijkl", eye, eye) + np.einsum("il,jk->ijkl", eye, eye))
    return C.reshape(9, 9)  # symmetric in (i, j): rows or columns first are the same


# --- registry ------------------------------------------------------------------------------------


@every_name
@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"E": 0.0}, ["E = 0.0", "from 1e-100 to 1e+100"]),
        ({"E": -1.0}, ["E = -1.0"]),
        ({"E": float("nan")}, ["E = nan"]),
        ({"E": float("inf")}, ["E = inf"]),
        ({"nu": 0.51}, ["nu = 0.51", "-1", "0.5"]),
        ({"nu": -1.0}, ["nu = -1.0"]),
        ({"nu": float("nan")}, ["nu = nan"]),
        ({"no_such_shape": 1.0}, ["no_such_shape", "E, nu"]),
    ],
)
def test_mistakes_are_one_line(name, given, words):
    with pytest.raises(BadInput) as caught:
        fem_snh.material(name, **given)
    message = str(caught.value)
    assert "\n" not in message
    assert all(word in message for word in words)


DROPPED_IN = '''
def gel(I_C, J, mu, lam, *, power=2):
    """A gel.

    psi = mu/2 (I_C - 3) - mu (J - 1) + lam/2 (J - 1)^power
    """
    return mu / 2 * (I_C - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** power
'''


@pytest.fixture
def gel(monkeypatch, tmp_path):
    """A file in one more folder of the package, with one function: that is all."""
    (tmp_path / "gel.py").write_text(DROPPED_IN)
    monkeypatch.setattr(models, "__path__", [*models.__path__, str(tmp_path)])
    importlib.invalidate_caches()
    yield "gel"
    sys.modules.pop("fem_snh.materials.gel", None)


def test_a_new_material_is_found_and_works(gel):
    assert gel in materials.names()
    assert materials.defaults(gel) == {"power": 2}
    m, same = fem_snh.material(gel), fem_snh.material("stable_neo_hookean", barrier=False)
    F = deformations([1.3, 0.8, -0.4])
    assert m.energy(F) == pytest.approx(same.energy(F), rel=1e-14)
    assert m.hessian(F, "clamp") == pytest.approx(same.hessian(F, "clamp"), rel=1e-12)


# --- normalisation and rest ----------------------------------------------------------------------


@every_material
def test_rest(m):
    """psi = 0, P = 0, and small strains obey Hooke's law, in every orientation."""
    m = make(*m)
    F = np.concatenate([np.eye(3)[None], deformations(np.ones((20, 3)))])
    scale = np.linalg.norm(hooke(m.expression.E, m.expression.nu))
    assert abs(m.energy(F)).max() <= 1e-14 * scale
    assert abs(m.pk1(F)).max() <= 1e-14 * scale
    assert abs(m.hessian(F[0]) - hooke(m.expression.E, m.expression.nu)).max() <= 1e-14 * scale
    # By the stress alone: P(I + h G) = h C:G + O(h^2), the error by order.
    G = np.random.default_rng(1).standard_normal((3, 3))
    linear = hooke(m.expression.E, m.expression.nu) @ vec(G)
    h = 2.0 ** -np.arange(8, 14)
    error = [np.linalg.norm(vec(m.pk1(np.eye(3) + x * G)) / x - linear) for x in h]
    assert np.polyfit(np.log(h), np.log(error), 1)[0] == pytest.approx(1, abs=0.05)


# --- stable_neo_hookean --------------------------------------------------------------------------


@pytest.mark.parametrize("nu", [0.1, 0.3, 0.45])
def test_without_barrier_is_equation_13(nu):
    m = make("stable_neo_hookean", nu, barrier=False)
    mu, lam = m.lame[0], m.lame[1] + m.lame[0]
    assert m.expression.values == pytest.approx((mu, lam), rel=1e-13)
    F = deformations(np.random.default_rng(2).uniform(-2, 2, (50, 3)))
    I_C, J = (F**2).sum((1, 2)), np.linalg.det(F)
    expected = mu / 2 * (I_C - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2
    assert m.energy(F) == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize("nu", [0.1, 0.3, 0.45])
def test_with_barrier_is_equation_14_with_the_right_alpha(nu):
    """alpha = 1 + mu/lam - mu/(4 lam); with the printed mu/4 lam the rest state is stressed.

    The material's own mu and lam are not Lame's: mu = 4/3 mu_lame, lam = lam_lame + 5/6 mu_lame.
    """
    m = make("stable_neo_hookean", nu, barrier=True)
    mu_lame, lam_lame = m.lame
    mu, lam = 4 / 3 * mu_lame, lam_lame + 5 / 6 * mu_lame
    assert m.expression.values == pytest.approx((mu, lam), rel=1e-13)
    assert (lam - 5 / 8 * mu) / (2 * (lam + mu / 8)) == pytest.approx(nu, rel=1e-12)  # eq. 16
    F = deformations(np.random.default_rng(2).uniform(-2, 2, (50, 3)))

    def psi(F, alpha):
        I_C, J = (F**2).sum((1, 2)), np.linalg.det(F)
        return mu / 2 * (I_C - 3) + lam / 2 * (J - alpha) ** 2 - mu / 2 * np.log(I_C + 1)

    right, printed = 1 + mu / lam - mu / (4 * lam), 1 + mu / lam - mu / 4 * lam
    rest = np.eye(3)[None]
    expected = psi(F, right) - psi(rest, right)
    assert m.energy(F) == pytest.approx(expected, rel=1e-12, abs=1e-12)
    h = 1e-6
    slope = [
        (psi(rest * (1 + h), a) - psi(rest * (1 - h), a))[0] / (2 * h) for a in (right, printed)
    ]
    assert abs(slope[0]) < 1e-8
    assert abs(slope[1]) > 1e-2


@pytest.mark.parametrize("nu", [0.3, 0.49])
def test_origin_is_stable_only_without_barrier(nu):
    """What the barrier is for: near F = 0 the Hessian of eq. 13 is mu I, of eq. 14 about 0."""
    F = 1e-4 * np.eye(3)
    free, barred = (make("stable_neo_hookean", nu, barrier=b).hessian(F) for b in (False, True))
    assert np.linalg.eigvalsh(free).min() > 0.1
    assert np.linalg.eigvalsh(barred).min() < 0


# --- one expression, several arithmetics ---------------------------------------------------------


@every_material
def test_expression_in_stretches_and_in_measures_agree(m):
    energy = make(*m).expression
    s = [mpmath.mpf("1.7"), mpmath.mpf("0.6"), mpmath.mpf("0.9")]
    with mpmath.workdps(50):
        values = {
            "I1": sum(s),
            "I_C": sum(x**2 for x in s),
            "II_C": (s[0] * s[1]) ** 2 + (s[0] * s[2]) ** 2 + (s[1] * s[2]) ** 2,
            "J": s[0] * s[1] * s[2],
        } | {f"s{i}": x for i, x in enumerate(s)}
        direct = energy.evaluate("mpmath", *(values[str(x)] for x in energy.measures))
        symbols = (*sympy.symbols("s0 s1 s2", real=True), *energy.constants)
        again = sympy.lambdify(symbols, energy.psi_sigma, "mpmath")(*s, *energy.values)
        assert abs(direct - again) <= mpmath.mpf(10) ** -45 * abs(direct)
