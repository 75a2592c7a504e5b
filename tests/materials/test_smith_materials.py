"""Stresses and Hessians of Smith et al. 2018, sections 3 and 5, against matrix formulas."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from points import STATES, deformations, make, vec

from fem_snh import materials

pytestmark = pytest.mark.one_debian

NU = 0.3
SHAPES = {"gamma_model": {"length": "I_C/2 + sqrt(I_C + 1)/5", "volume": "exp(J - 1) - J"}}
GRADIENTS = deformations([*STATES.values(), (0.9, 0.7, 0.5), (1.2, 0.6, 0.1), (1, 0.3, -2)])


def cofactor(F):
    """dJ/dF, by cross products of columns: right for singular F too."""
    a, b, c = F.T
    return np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)]).T


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
    for F in GRADIENTS:
        I_C, J = (F**2).sum(), np.linalg.det(F)
        g_I, g_F, g_G, g_H = four(name, I_C, J, *m.expression.values)
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
