"""Smith et al. 2018, sections 3 and 5: stresses and Hessians as matrices, errata, thresholds."""

from __future__ import annotations

import numpy as np
import pytest
import sympy
from points import STATES, deformations, law, observed_order, vec

from fem_snh import materials
from fem_snh.errors import BadInput
from fem_snh.materials.invariants import SIGMA

NU = 0.3
UPRIGHT = deformations([STATES["random"], STATES["stretched"], (0.9, 0.7, 0.5), (1.2, 0.6, 0.1)])
ANY = np.concatenate([UPRIGHT, deformations([STATES["inverted"], STATES["everted"], (1, 0.3, -2)])])
LENGTH, VOLUME = "I_C/2 + sqrt(I_C + 1)/5", "exp(J - 1) - J"


def invariants(F):
    return (F**2).sum(), np.linalg.det(F)


def cofactor(F):
    """dJ/dF, by cross products of columns: right for singular F too."""
    a, b, c = F.T
    return np.array([np.cross(b, c), np.cross(c, a), np.cross(a, b)]).T


def rotation(F):
    """R of F = R S with det R = 1 (rotation-variant, eq. 2)."""
    U, _, Vt = np.linalg.svd(F)
    return U @ np.diag([1, 1, np.linalg.det(U @ Vt)]) @ Vt


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
    m = law(name, NU, **SHAPES.get(name, {}))
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
    m = law(name, NU, **SHAPES.get(name, {}))
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
    m = law("filtered_neo_hookean", NU, bound="J")
    rng = np.random.default_rng(0)
    s = -np.sort(-rng.uniform(0, 2, (400, 3)) * rng.choice([0.2, 1], (400, 3)), axis=1)
    s[::2, 2] *= -1
    s = np.concatenate([s, [(0, 0, 0), (1, 0, 0), (0.5, 0.5, 0.5), (1, 1, 0.25), (1, 1, -1)]])
    expected = np.array([by_clamping(x, *m.lame) for x in s])
    found = np.diagonal(m.pk1(np.array([np.diag(x) for x in s])), axis1=1, axis2=2)
    assert found == pytest.approx(expected, rel=1e-12, abs=1e-12)
    above = s.prod(axis=1) >= 0.25
    assert 20 < above.sum() < len(s) - 20
    plain = law("neo_hookean", NU).pk1(np.array([np.diag(x) for x in s[above]]))
    assert np.diagonal(plain, axis1=1, axis2=2) == pytest.approx(expected[above], rel=1e-11)
    with pytest.raises(BadInput, match="bound"):
        materials.make_energy("filtered_neo_hookean", bound="area")


def test_filter_of_the_volume_has_a_tangent():
    """Its Hessian is the symmetric part of the derivative of its stress, filtered or not."""
    m, h = law("filtered_neo_hookean", NU, bound="J"), 1e-6
    for sigma in [(1.4, 0.9, 0.6), (1.4, 0.9, 0.1), (2.0, 0.3, 0.2), (0.5, 0.4, -0.3)]:
        F = deformations(sigma, seed=11)
        columns = [
            (vec(m.pk1(F + h * D)) - vec(m.pk1(F - h * D))) / (2 * h)
            for D in np.swapaxes(np.eye(9).reshape(9, 3, 3), 1, 2)
        ]
        D = np.array(columns).T
        assert m.hessian(F) == pytest.approx((D + D.T) / 2, abs=1e-7 * abs(D).max())


def test_extrapolated_energies_agree_to_second_order():
    """Along the ray from the identity, ours (in J) and Stomakhin et al.'s (all of psi, in the
    stretches) differ by the third power of the distance beyond J = threshold."""
    m, plain = law("c2_neo_hookean", NU), law("neo_hookean", NU)
    end, a = np.array([1.2, 0.5, -0.7]), 0.4
    t = min(x.real for x in np.roots(_along(end, a)) if abs(x.imag) < 1e-12 and 0 < x.real < 1)
    q, u = 1 + t * (end - 1), (end - 1) / np.linalg.norm(end - 1)
    assert q.prod() == pytest.approx(a)
    slope = np.diag(plain.pk1(np.diag(q))) @ u
    D = vec(np.diag(u))
    curvature = D @ plain.hessian(np.diag(q)) @ D
    h = 0.2 * 2.0 ** -np.arange(7)
    theirs = plain.energy(np.diag(q)) + slope * h + curvature / 2 * h**2
    ours = m.energy(np.array([np.diag(q + x * u) for x in h]))
    error = abs(ours - theirs)
    assert observed_order(h, error, np.full(7, 1e-15)) == pytest.approx(3, abs=0.1)


def _along(end, a):
    """The cubic prod(1 + t (end - 1)) - a in t."""
    cubic = np.polynomial.Polynomial([1.0])
    for x in end:
        cubic *= np.polynomial.Polynomial([1.0, x - 1])
    return (cubic - a).coef[::-1]


# --- what they are said to do --------------------------------------------------------------------


def test_wang_has_a_pressure_for_a_volume_term():
    """Uniform stretch: the energy is linear in J, so it falls all the way to J = 0."""
    m = law("neo_hookean_wang", NU)
    J = np.array([0.01, 0.25, 1.0, 4.0, 64.0])
    F = np.cbrt(J)[:, None, None] * np.eye(3)
    lam = m.expression.values[1]
    assert m.energy(F) == pytest.approx(lam / 2 * (J - 1), rel=1e-11, abs=1e-12)
    assert m.expression.rest_stress == pytest.approx(lam / 2, rel=1e-12)


def test_mooney_length_deflates():
    """P(I) = mu I (eq. 10): the energy falls from rest as the body shrinks; SNH's rises."""
    m, snh = law("mooney_length", NU), law("stable_neo_hookean", NU)
    assert m.pk1(np.eye(3)) == pytest.approx(m.expression.values[0] * np.eye(3), rel=1e-12)
    smaller = 0.99 * np.eye(3)
    assert m.energy(smaller) < 0 < snh.energy(smaller)


def test_neo_hookean_bower_lets_go_under_uniform_compression():
    m = law("neo_hookean_bower", NU)
    assert m.energy(1e-3 * np.eye(3)) == pytest.approx(m.expression.values[1] / 2, rel=1e-6)
    assert m.energy(np.diag([1, 1, 1e-6])) > 1e3 * m.expression.E
