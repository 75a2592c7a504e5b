"""Stresses and Hessians of Smith et al. 2018, sections 3 and 5, against matrix formulas."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from points import make, vec
from smith_formulas import ANY, LENGTH, NU, UPRIGHT, VOLUME, cofactor, invariants, rotation

from fem_snh import materials

pytestmark = pytest.mark.one_debian

# --- first Piola-Kirchhoff stress, in each material's own constants -------------------------------


def ogden(F, mu, lam):
    return mu * (F - np.linalg.inv(F).T) + lam * (np.linalg.det(F) - 1) * cofactor(F)


def isochoric(F, mu):
    I_C, J = invariants(F)
    return mu * J ** (-2 / 3) * (F - I_C / 3 * np.linalg.inv(F).T)


def bower(F, mu, lam):
    return isochoric(F, mu) + lam * (np.linalg.det(F) - 1) * cofactor(F)


def wang(F, mu, lam):
    """The volume term is a pressure that does not change: lam/2 dJ/dF."""
    return isochoric(F, mu) + lam / 2 * cofactor(F)


def mooney(F, mu, lam):
    """Eq. 9."""
    return mu * F + lam * cofactor(F) * (np.linalg.det(F) - 1)


def corotational(F, mu, lam):
    """Eq. 4 is printed with mu for the 2 mu of eq. 3."""
    R = rotation(F)
    return R @ (2 * mu * (R.T @ F - np.eye(3)) + lam * np.trace(R.T @ F - np.eye(3)) * np.eye(3))


def stvk(F, mu, lam):
    E = (F.T @ F - np.eye(3)) / 2
    return F @ (2 * mu * E + lam * np.trace(E) * np.eye(3))


def kikuuwe(F, mu, lam, kappa=400.0):
    J = np.linalg.det(F)
    return stvk(F, mu, lam) - (kappa * mu / 24 * max(0, (1 - J) / 6) ** 2) * cofactor(F)


def fung(F, mu, lam):
    """Eq. 54 with the factor 1/2 that it lacks."""
    I_C, J = invariants(F)
    gamma, mu_1 = 0.1 * mu, 1.0
    alpha = 1 + (mu + gamma * mu_1 / 2) / lam
    stiffening = gamma * mu_1 / 2 * np.exp(mu_1 / 2 * (I_C - 3))
    return (mu + stiffening) * F + lam * cofactor(F) * (J - alpha)


def arruda_boyce(F, mu, lam):
    """Eq. 59."""
    I_C, J = invariants(F)
    b1, b2 = 1 / 40, 11 / 11200
    alpha = 1 + mu / lam * (1 + 3 * b1 + 9 * b2)
    return mu * (1 + b1 * I_C + b2 * I_C**2) * F + lam * cofactor(F) * (J - alpha)


def c2(F, mu, lam, a=0.4):
    """mu F + V'(J) dJ/dF, V' linear below J = a."""
    J = np.linalg.det(F)
    if a <= J:
        slope = (lam * np.log(J) - mu) / J
    else:
        slope = (lam * np.log(a) - mu) / a + (mu + lam - lam * np.log(a)) / a**2 * (J - a)
    return mu * F + slope * cofactor(F)


def gammas(F, mu, lam):
    """The general model with LENGTH and VOLUME, rest-stable: p = 2 mu f'(3) + lam g'(1)."""
    I_C, J = invariants(F)
    p = 2 * mu * (0.5 + 0.1 / 2)
    return 2 * mu * (0.5 + 0.1 / np.sqrt(I_C + 1)) * F + (lam * (np.exp(J - 1) - 1) - p) * cofactor(
        F
    )


def own_fung(m, k):
    mu = m / (1 + 0.1 / 2)
    return mu, k + m - 0.1 * mu / 2


def own_arruda_boyce(m, k):
    b1, b2 = 1 / 40, 11 / 11200
    mu = m / (1 + 3 * b1 + 9 * b2)
    return mu, k + m - 2 * mu * (b1 + 6 * b2)


def own_gammas(m, k):
    mu = m / 1.1
    return mu, k + m + mu / 40


def same(m, k):
    return m, k


#: The stress, the own (mu, lam) from Lame's (m, k), and whether every F is in the domain.
STRESSES = {
    "neo_hookean_ogden": (ogden, same, False),
    "neo_hookean_bower": (bower, lambda m, k: (m, k + 2 * m / 3), False),
    "neo_hookean_wang": (wang, lambda m, k: (3 * m / 2 + 3 * k / 4, 3 * k + 2 * m), False),
    "mooney_length": (mooney, lambda m, k: (2 * m, k), True),
    "corotational": (corotational, same, True),
    "stvk": (stvk, same, True),
    "stvk_kikuuwe": (kikuuwe, same, True),
    "stable_fung": (fung, own_fung, True),
    "stable_arruda_boyce": (arruda_boyce, own_arruda_boyce, True),
    "c2_neo_hookean": (c2, same, True),
    "gamma_model": (gammas, own_gammas, True),
}
SHAPES = {"gamma_model": {"length": LENGTH, "volume": VOLUME}}


@pytest.mark.parametrize("name", STRESSES)
def test_stress(name):
    """P(F) as a matrix, at rest too, where mooney_length and neo_hookean_wang are stressed."""
    stress, own, everywhere = STRESSES[name]
    m = make(name, NU, **SHAPES.get(name, {}))
    mu, lam = own(1.7 / (2 * (1 + NU)), 1.7 * NU / ((1 + NU) * (1 - 2 * NU)))
    assert m.expression.values == pytest.approx((mu, lam), rel=1e-12)
    for F in [*(ANY if everywhere else UPRIGHT), np.eye(3)]:
        expected = stress(F, mu, lam)
        size = abs(expected).max() + m.expression.E
        assert m.pk1(F) == pytest.approx(expected, abs=1e-12 * size * (1 + abs(F).max()))


# --- eq. 52 --------------------------------------------------------------------------------------


def hessian_of_volume(F):
    """d2J/dF2 (eq. 28), on columns."""
    e = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        e[i, j, k], e[k, j, i] = 1, -1
    H = np.einsum("ikm,jln,mn->jilk", e, e, F)
    return H.reshape(9, 9)


def four(name, I_C, J, mu, lam):
    """(gamma_I, gamma_F, gamma_G, gamma_H) as printed (eq. 41, 55, 60), the errata put right."""
    if name == "stable_neo_hookean":
        alpha = 1 + mu / lam - mu / (4 * lam)
        return mu * (1 - 1 / (I_C + 1)), 2 * mu / (I_C + 1) ** 2, lam, lam * (J - alpha)
    if name == "stable_fung":
        gamma, mu_1 = 0.1 * mu, 1.0
        growth = np.exp(mu_1 / 2 * (I_C - 3))
        alpha = 1 + (mu + gamma * mu_1 / 2) / lam
        stiff, stiffer = gamma * mu_1 / 2 * growth, gamma * mu_1**2 / 2 * growth
        return mu + stiff, stiffer, lam, lam * (J - alpha)
    if name == "stable_arruda_boyce":
        b1, b2 = 1 / 40, 11 / 11200
        alpha = 1 + mu / lam * (1 + 3 * b1 + 9 * b2)
        gamma_F = 2 * mu * (b1 + 2 * b2 * I_C)
        return mu * (1 + b1 * I_C + b2 * I_C**2), gamma_F, lam, lam * (J - alpha)
    slope = lam * (np.exp(J - 1) - 1) - 1.1 * mu
    root = np.sqrt(I_C + 1)
    return mu * (1 + 0.2 / root), -0.2 * mu / root**3, lam * np.exp(J - 1), slope


@pytest.mark.parametrize(
    "name", ["stable_neo_hookean", "stable_fung", "stable_arruda_boyce", "gamma_model"]
)
def test_the_general_model(name):
    """The whole Hessian is gamma_I I + gamma_F f f^T + gamma_G g g^T + gamma_H H (eq. 52), and its
    twists and flips are gamma_I +- gamma_H sigma_i (eq. 46-48)."""
    m = make(name, NU, **SHAPES.get(name, {}))
    for F in ANY:
        g_I, g_F, g_G, g_H = four(name, *invariants(F), *m.expression.values)
        f, g = vec(F), vec(cofactor(F))
        A = g_I * np.eye(9) + g_F * np.outer(f, f) + g_G * np.outer(g, g)
        A += g_H * hessian_of_volume(F)
        assert m.hessian(F) == pytest.approx(A, abs=1e-12 * abs(A).max())
        s = np.linalg.svd(F, compute_uv=False) * [1, 1, np.sign(np.linalg.det(F))]
        found = m.eigensystem(F)[0][3:]
        expected = np.concatenate([g_I + g_H * s, g_I - g_H * s])
        assert found == pytest.approx(expected, abs=1e-12 * abs(A).max())


def test_alphas_of_rest_stability():
    """alpha = J at which the volume term has its minimum, from P(I) = 0: exact, in symbols."""
    shape = sympy.symbols("gamma beta_1 beta_2", positive=True)
    I_C, J, mu, lam = sympy.symbols("I_C J mu lam", positive=True)
    mu_1 = sympy.Integer(2)
    gamma, b1, b2 = shape
    from_file = {
        name: materials.function(name)(I_C, J, mu, lam, **keywords)
        for name, keywords in {
            "stable_fung": {"gamma": gamma, "mu_1": mu_1},
            "stable_arruda_boyce": {"betas": (b1, b2)},
            "stable_neo_hookean": {"barrier": True, "nu": NU},
        }.items()
    }
    expected = {
        "stable_fung": 1 + (mu + gamma * mu * mu_1 / 2) / lam,  # not mu + gamma mu_1
        "stable_arruda_boyce": 1 + mu / lam * (1 + 3 * b1 + 9 * b2),
        "stable_neo_hookean": 1 + mu / lam - mu / (4 * lam),  # not - mu/4 lam
    }
    for name, psi in from_file.items():
        stress = 2 * psi.diff(I_C) + psi.diff(J)  # on the diagonal at F = I
        assert sympy.simplify(stress.subs({I_C: 3, J: 1})) == 0
        alpha = sympy.solve(psi.diff(J), J)
        assert [sympy.simplify(a - expected[name]) for a in alpha] == [0]
