"""The kernels at single points, against expressions, derivatives, 50 digits and numpy's eigh."""

from __future__ import annotations

from functools import lru_cache

import hypothesis.strategies as st
import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import assume, given
from hypothesis.extra.numpy import arrays
from points import (
    KINDS,
    STATES,
    deformations,
    every_kind,
    every_material,
    filtered,
    law,
    observed_order,
    rotations,
    spread,
    vec,
)

from benchmarks.eigensolvers import cubic_coefficients, cubic_vector, paper_terms
from fem_snh.choices import EIGENSOLVERS, FILTERS
from fem_snh.kernels.pointwise import Material
from fem_snh.kernels.svd_eigen import svd
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA

every_state = pytest.mark.parametrize("state", list(STATES))
PAIRS = ((1, 2), (0, 2), (0, 1))  # the stretches that twist and flip i couple


def inside(m: Material, F: np.ndarray) -> np.ndarray:
    """``F``, or a skip where the energy is infinite."""
    if not np.isfinite(m.energy(F)):
        pytest.skip("infinite energy")
    return F


# --- derivatives ---------------------------------------------------------------------------------


@every_state
@every_material
def test_stress_and_hessian_by_order_of_convergence(m, state):
    """Central differences of psi tend to P, and of P to the Hessian, as h^2 until rounding."""
    m = law(*m)
    F = inside(m, deformations(STATES[state], seed=7))
    D = np.random.default_rng(8).standard_normal((3, 3))
    D /= np.linalg.norm(D)
    h = 0.02 * 2.0 ** -np.arange(9)
    points = F + h[:, None, None] * D, F - h[:, None, None] * D
    up, down = (m.energy(x) for x in points)
    error = abs((up - down) / (2 * h) - (m.pk1(F) * D).sum())
    size = abs(m.energy(F)) + np.linalg.norm(m.pk1(F)) * np.linalg.norm(F)
    assert observed_order(h, error, 1e-16 * size / h) == pytest.approx(2, abs=0.15)
    up, down = (vec(m.pk1(x)) for x in points)
    error = np.linalg.norm((up - down) / (2 * h[:, None]) - m.hessian(F) @ vec(D), axis=1)
    size = np.linalg.norm(m.pk1(F)) + np.linalg.norm(m.hessian(F)) * np.linalg.norm(F)
    assert observed_order(h, error, 1e-16 * size / h) == pytest.approx(2, abs=0.15)


# --- 50 digits -----------------------------------------------------------------------------------


def exactly(A: np.ndarray) -> mpmath.matrix:
    return mpmath.matrix(A.tolist())


def psi_exactly(energy: Energy, F: mpmath.matrix) -> mpmath.mpf:
    """psi(F) in the working precision of mpmath."""
    C = F.T * F
    values = {
        "I_C": C[0, 0] + C[1, 1] + C[2, 2],
        "II_C": ((C[0, 0] + C[1, 1] + C[2, 2]) ** 2 - sum(x**2 for x in C)) / 2,
        "J": mpmath.det(F),
    }
    if energy.needs_stretches:
        s = [mpmath.sqrt(x) for x in mpmath.eigsy(C, eigvals_only=True)]
        s[0] *= mpmath.sign(values["J"])  # the smallest
        values |= {"I1": sum(s)} | {f"s{i}": s[2 - i] for i in range(3)}
    return energy.evaluate("mpmath", *(values[str(x)] for x in energy.measures))


@every_state
@every_material
def test_against_fifty_digits(m, state):
    """Energy, stress and Hessian: differences of the energy that are exact to 25 digits."""
    m = law(*m)
    F = inside(m, deformations(STATES[state], seed=3))
    P, H = m.pk1(F), m.hessian(F)
    with mpmath.workdps(80):
        f, h = exactly(F), mpmath.mpf(10) ** -18
        energy = psi_exactly(m.expression, f)
        scale = abs(m.energy(F)) + np.linalg.norm(P) * np.linalg.norm(F)
        assert abs(m.energy(F) - energy) <= 1e-14 * scale
        rng = np.random.default_rng(4)
        entry = np.eye(9).reshape(9, 3, 3)
        for A, B in [*rng.standard_normal((3, 2, 3, 3)), *zip(entry[:3], entry[[0, 5, 8]])]:
            a, b = exactly(A), exactly(B)
            corner = [
                psi_exactly(m.expression, f + h * (x * a + y * b)) for x in (1, -1) for y in (1, -1)
            ]
            slope = (corner[0] + corner[1] - corner[2] - corner[3]) / (4 * h)
            curvature = (corner[0] - corner[1] - corner[2] + corner[3]) / (4 * h**2)
            assert abs((P * A).sum() - float(slope)) <= 1e-13 * np.linalg.norm(P)
            found = vec(A) @ H @ vec(B)
            assert (
                abs(found - float(curvature)) <= 1e-13 * np.linalg.norm(H) * np.linalg.norm(A) * 3
            )


@lru_cache
def principal(energy: Energy):
    """psi_i and psi_ij of the stretches and the constants, by sympy, for mpmath."""
    first = [sympy.diff(energy.psi_sigma, s) for s in SIGMA]
    second = [[sympy.diff(p, s) for s in SIGMA] for p in first]
    return sympy.lambdify((*SIGMA, *energy.constants), (first, second), "mpmath")


NEAR = [1e-3, 1e-5, 1e-6, 1e-8, 1e-12, 1e-15]


@every_material
@pytest.mark.parametrize(
    "sigma",
    [*STATES.values(), *[(1.3, 1.3 - d, 0.7) for d in NEAR], *[(1.1 + d, 1.1, 1.1) for d in NEAR]],
)
def test_eigenvalues_against_fifty_digits(m, sigma):
    """Scaling, twist and flip from sympy's derivatives in the stretches, near-equal ones too."""
    m = law(*m)
    F = inside(m, np.diag(sigma))
    s = svd(F)[1]
    values, _ = m.eigensystem(F)
    assert_eigenvalues(m, s, values, 1e-13)


def assert_eigenvalues(m: Material, s: np.ndarray, values: np.ndarray, bound: float) -> None:
    with mpmath.workdps(60):
        s = [mpmath.mpf(float(x)) for x in s]
        # Equal stretches are told apart by 1e-25: the divided difference is then the limit.
        s = [x + k * mpmath.mpf(10) ** -25 for k, x in enumerate(s)]
        first, second = principal(m.expression)(*s, *m.expression.values)
        scaling = sorted(mpmath.eigsy(mpmath.matrix(second), eigvals_only=True), reverse=True)
        twist = [(first[j] + first[k]) / (s[j] + s[k]) for j, k in PAIRS]
        flip = [(first[j] - first[k]) / (s[j] - s[k]) for j, k in PAIRS]
        expected = np.array([float(x) for x in (*scaling, *twist, *flip)])
    assert abs(values - expected).max() <= bound * abs(expected).max()


# --- invariance ----------------------------------------------------------------------------------

entries = st.floats(-2, 2, allow_subnormal=False)
gradients = arrays(float, (3, 3), elements=entries)
turns = st.integers(0, 999).map(lambda seed: rotations(1, seed)[0])


def rounding(m: Material, F: np.ndarray) -> tuple[float, float, float]:
    """What rounding F may change in psi, P and the Hessian."""
    size = np.linalg.norm(F) + 1e-30
    P, H = np.linalg.norm(m.pk1(F)), np.linalg.norm(m.hessian(F))
    E = m.expression.E / (1 - 2 * m.expression.nu)
    return 1e-13 * (E + m.energy(F) + P * size), 1e-13 * (E + P + H * size), 1e-13 * (E + H)


@every_material
@given(F=gradients, Q=turns)
def test_frame_invariance_and_isotropy(m, F, Q):
    """psi(QF) = psi(FQ) = psi(F), P(QF) = Q P(F), P(FQ) = P(F) Q."""
    m = law(*m)
    assume(abs(np.linalg.det(F)) > 1e-3)  # not where a rounding decides whether psi is finite
    psi, P = m.energy(F), m.pk1(F)
    if np.isinf(psi):
        assert np.isinf(m.energy(Q @ F))
        assert np.isinf(m.energy(F @ Q))
        return
    s = svd(F)[1]
    assume(not m.expression.needs_stretches or s[1] + s[2] > 1e-3)  # where the polar rotation jumps
    of_psi, of_P, _ = rounding(m, F)
    for turned in (Q @ F, F @ Q):
        assert abs(m.energy(turned) - psi) <= of_psi
    assert abs(m.pk1(Q @ F) - Q @ P).max() <= of_P
    assert abs(m.pk1(F @ Q) - P @ Q).max() <= of_P


@pytest.mark.parametrize("nu", [0.3, 0.49])
@given(F=gradients, order=st.permutations(range(3)), mirror=st.integers(0, 2))
def test_no_convention_of_the_svd_matters(nu, F, order, mirror):
    """The Hessian of stable_neo_hookean by eq. 41 from *any* order and signs of the stretches."""
    m = law("stable_neo_hookean", nu)
    U, s, V = np.linalg.svd(F)
    V = V.T
    U, s, V = U[:, order], s[list(order)], V[:, order]
    if np.linalg.det(U @ V) < 0:  # one stretch is negative: any one
        V = V * np.where(np.arange(3) == mirror, -1, 1)
        s = s * np.where(np.arange(3) == mirror, -1, 1)
    gamma_I, gamma_H, eta_H, rho_H = scaled_terms(m, s)
    H = gamma_I * np.eye(9) + eta_H * np.outer(vec(F), vec(F))
    g = vec(U @ np.diag([s[1] * s[2], s[0] * s[2], s[0] * s[1]]) @ V.T)
    H += rho_H * np.outer(g, g)
    o = [[vec(np.outer(U[:, a], V[:, b])) for b in range(3)] for a in range(3)]
    for i, (j, k) in enumerate(PAIRS):
        for a, b in ((o[j][j], o[k][k]), (o[k][k], o[j][j])):
            H += gamma_H * s[i] * np.outer(a, b)
        for a, b in ((o[j][k], o[k][j]), (o[k][j], o[j][k])):
            H -= gamma_H * s[i] * np.outer(a, b)
    assert abs(m.hessian(F) - H).max() <= rounding(m, F)[2]


def scaled_terms(m: Material, s: np.ndarray) -> tuple[float, float, float, float]:
    """gamma_I, gamma_H, gamma_H eta, gamma_H rho: finite also where gamma_H is 0."""
    gamma_I, gamma_H, _, _ = paper_terms(m, s.astype(object) + sympy.Rational(0))
    mu, lam = m.expression.values
    I_C = (s**2).sum()
    eta_H = 2 * mu / (I_C + 1) ** 2 if m.expression.nu < 0.4 else 0.0
    return float(gamma_I), float(gamma_H), eta_H, lam


# --- the paper's eigensystem ---------------------------------------------------------------------

APPENDIX_A = {
    3: [[0, 0, 0], [0, 0, 1], [0, -1, 0]],
    4: [[0, 0, 1], [0, 0, 0], [-1, 0, 0]],
    5: [[0, 1, 0], [-1, 0, 0], [0, 0, 0]],
    6: [[0, 0, 0], [0, 0, 1], [0, 1, 0]],
    7: [[0, 0, 1], [0, 0, 0], [1, 0, 0]],
    8: [[0, 1, 0], [1, 0, 0], [0, 0, 0]],
}


@pytest.mark.parametrize("solver", EIGENSOLVERS)
@every_kind
@every_material
def test_eigensystem(m, kind, solver):
    """H v = lambda v, orthonormal, in the paper's order, twist and flip as in Appendix A."""
    m = law(*m)
    F = deformations(KINDS[kind], seed=9)
    values, vectors = m.eigensystem(F, solver)
    H = m.hessian(F)
    size = spread(H)[:, None, None]
    assert np.all(abs(H @ vectors - vectors * values[:, None, :]) <= 2e-14 * size)
    assert abs(np.swapaxes(vectors, 1, 2) @ vectors - np.eye(9)).max() <= 1e-14
    assert np.all(np.diff(values[:, :3], axis=1) <= 1e-14 * size[:, 0])
    U, _, V = svd(F)
    for k, D in APPENDIX_A.items():
        expected = vec(U @ np.array(D) @ np.swapaxes(V, 1, 2)) / np.sqrt(2)
        assert abs(vectors[:, :, k] - expected).max() <= 1e-14


@pytest.mark.parametrize("barrier", [True, False])
@every_state
def test_equations_45_to_48(state, barrier):
    """eps_k = gamma_H root_k + mu_T, twist and flip = +-gamma_H sigma_i + mu_T."""
    m = law("stable_neo_hookean", 0.45, barrier=barrier)
    F = deformations(STATES[state], seed=2)
    s = svd(F)[1]
    gamma_I, gamma_H, eta, rho = paper_terms(m, s)
    roots = np.roots([1.0, *cubic_coefficients(s, eta, rho)]).real
    expected = [*np.sort(gamma_H * roots + gamma_I)[::-1]]
    expected += [*(gamma_I + gamma_H * s), *(gamma_I - gamma_H * s)]
    values, vectors = m.eigensystem(F)
    assert values == pytest.approx(np.array(expected), rel=0, abs=1e-11 * abs(values).max())
    U, _, V = svd(F)
    for k in range(3):
        D = np.array(cubic_vector(s, (values[k] - gamma_I) / gamma_H, eta, rho))
        d = vec(U @ np.diag(D / np.linalg.norm(D)) @ V.T)
        assert abs(d @ vectors[:, k]) == pytest.approx(1, abs=1e-10)


@pytest.fixture(scope="module")
def block():
    """H + rho g g^T + eta f f^T in the frame of the stretches, symbolically, and its symbols."""
    s, (eta, rho, e) = sympy.symbols("s0:3"), sympy.symbols("eta rho e")
    H = sympy.Matrix([[0, s[2], s[1]], [s[2], 0, s[0]], [s[1], s[0], 0]])
    g, f = sympy.Matrix([s[1] * s[2], s[0] * s[2], s[0] * s[1]]), sympy.Matrix(s)
    return H + rho * g * g.T + eta * f * f.T, s, eta, rho, e


def test_equation_42_and_66_are_right(block):
    A, s, eta, rho, e = block
    polynomial = sympy.Poly((e * sympy.eye(3) - A).det(), e).all_coeffs()
    for found, expected in zip(polynomial[1:], cubic_coefficients(s, eta, rho), strict=True):
        assert sympy.expand(found - expected) == 0
    J, I_C = s[0] * s[1] * s[2], sum(x**2 for x in s)
    g = sum((s[j] * s[k]) ** 2 for j, k in PAIRS)
    eq66 = e**3 - rho * g * e**2 - (1 + 2 * rho * J) * I_C * e - (2 + 3 * rho * J) * J
    ours = e**3 + sum(c * e**k for c, k in zip(cubic_coefficients(s, 0, rho), (2, 1, 0)))
    assert sympy.expand(eq66 - ours) == 0


def test_equation_44_has_one_wrong_sign_and_67_is_right(block):
    A, s, eta, rho, e = block
    d = cubic_vector(s, e, eta, rho)
    B = A - e * sympy.eye(3)
    cross = B.row(0).cross(B.row(1))  # spans the null space of B at a simple root e
    assert [sympy.expand(x - y) for x, y in zip(cross, d, strict=True)] == [0, 0, 0]
    # alpha_1 as printed, with s0^2 - s1^2 + s2^2:
    printed = d[1] - 2 * s[0] * s[2] ** 2 * eta
    bracket = -s[0] * (s[0] ** 2 - s[1] ** 2 + s[2] ** 2) * eta
    right = -s[0] * (s[0] ** 2 - s[1] ** 2 - s[2] ** 2) * eta
    assert sympy.expand(printed - d[1] - (bracket - right)) == 0
    assert sympy.expand(cross[1] - printed) != 0
    J = s[0] * s[1] * s[2]
    alpha = 1 + rho * J
    beta = alpha + rho * (J + (s[0] ** 2 + s[1] ** 2) * e)
    eq67 = (
        alpha * (s[0] * s[2] + s[1] * e),
        alpha * (s[1] * s[2] + s[0] * e),
        e**2 - beta * s[2] ** 2,
    )
    ours = cubic_vector(s, e, 0, rho)
    assert [sympy.expand(x - y) for x, y in zip(eq67, ours, strict=True)] == [0, 0, 0]


# --- filters -------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", EIGENSOLVERS)
@pytest.mark.parametrize("filter", ["clamp", "abs"])
@every_kind
@every_material
def test_filters_against_eigh(m, kind, filter, solver):
    m = law(*m)
    F = deformations(KINDS[kind], seed=1)
    H, found = m.hessian(F, "exact", solver), m.hessian(F, filter, solver)
    assert np.isfinite(H).all()
    assert np.isfinite(found).all()
    size = spread(H)[:, None, None]
    assert np.all(abs(found - filtered(H, filter)) <= 5e-15 * size)
    assert np.all(found == np.swapaxes(found, 1, 2))
    assert np.all(np.linalg.eigvalsh(found / size) >= -5e-15)


@every_material
def test_nothing_is_touched_where_the_hessian_is_positive_definite(m):
    m = law(*m)
    rng = np.random.default_rng(3)
    F = np.eye(3) + 0.02 * rng.standard_normal((500, 3, 3))
    H = m.hessian(F)
    positive = np.linalg.eigvalsh(H)[:, 0] > 1e-6 * spread(H)
    assert positive.any()
    for filter in ("clamp", "abs"):
        assert np.array_equal(m.hessian(F, filter)[positive], H[positive])


@every_material
def test_a_point_does_not_depend_on_its_neighbours(m):
    """Eight points go at a time, and with other ranks come other neighbours."""
    m = law(*m)
    F = deformations(np.concatenate([KINDS[k] for k in KINDS])[::7], seed=4)
    for filter in FILTERS:
        alone = np.array([m.hessian(f, filter) for f in F])
        assert np.array_equal(m.hessian(F, filter), alone)


#: Entries that are not finite: outside every domain.
OUT = np.stack([np.eye(3)] * 5)
OUT[0, 0, 0] = OUT[1, 1, 2] = np.nan
OUT[2, 2, 2], OUT[3, 0, 1] = np.inf, -np.inf
OUT[4] = np.nan


@every_material
def test_outside_the_domain(m):
    """Energy +inf, all else zero."""
    m = law(*m)
    F = np.concatenate([OUT, deformations([[2, 1, -1e-3], [1, 1, 0], [3, -1, 2]])])
    psi = m.energy(F)
    assert not np.isnan(psi).any()
    assert np.all(psi[: len(OUT)] == np.inf)
    outside = np.isinf(psi)
    parts = [m.pk1(F), *(m.hessian(F, f, s) for f in FILTERS for s in EIGENSOLVERS)]
    for part in parts:
        assert np.isfinite(part).all()
        assert not part[outside].any()
    values, vectors = m.eigensystem(F)
    assert not values[outside].any()
    assert np.isfinite(vectors).all()
    assert m.energy(1e110 * np.eye(3)) == np.inf  # overflows


@every_material
@given(F=arrays(float, (3, 3), elements=st.floats(width=64)))
def test_never_nan(m, F):
    m = law(*m)
    assert m.energy(F) == m.energy(F)
    for part in (m.pk1(F), m.hessian(F), m.hessian(F, "clamp"), *m.eigensystem(F)):
        assert np.isfinite(part).all()


def test_shapes_and_choices():
    m = law("neo_hookean", 0.3)
    F = np.tile(np.eye(3), (2, 3, 1, 1))
    assert m.energy(F).shape == (2, 3)
    assert m.pk1(F).shape == (2, 3, 3, 3)
    assert m.hessian(F).shape == (2, 3, 9, 9)
    assert [a.shape for a in m.eigensystem(F)] == [(2, 3, 9), (2, 3, 9, 9)]
    assert m.energy(np.empty((0, 3, 3))).shape == (0,)
    assert m.hessian(np.empty((4, 0, 3, 3))).shape == (4, 0, 9, 9)
    assert m.energy(np.eye(3, dtype=int)) == 0
    with pytest.raises(ValueError, match=r"\(3, 3\)"):
        m.energy(np.eye(2))
    for wrong in ({"filter": "clamps"}, {"eigensolver": "qubic"}):
        with pytest.raises(ValueError, match="did you mean"):
            m.hessian(F, **wrong)


# --- energies that no material has yet -----------------------------------------------------------


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
    """A real power, with J to keep it at rest."""
    p = sympy.Rational(7, 2)
    J = s0 * s1 * s2
    return mu * sum(s**p - 1 for s in (s0, s1, s2)) - p * mu * sympy.log(J) + lam * (J - 1) ** 2


def corotational(I1, I_C, mu, lam):
    """Of I1 and not linear in it."""
    return mu * (I_C - 2 * I1 + 3) + lam / 2 * (I1 - 3) ** 2


def mooney(I_C, II_C, J, mu, lam):
    return mu * (I_C - 3) + mu / 3 * (II_C - 3) - 10 * mu / 3 * sympy.log(J) + lam * (J - 1) ** 2


def second_alone(II_C, J, mu, lam):
    return mu / 4 * (II_C - 3) ** 2 + mu * (II_C - 3) - 4 * mu * (J - 1) + lam / 2 * (J - 1) ** 2


def all_four(I1, I_C, II_C, J, mu, lam):
    return mu * (I_C + I1 * II_C / 3 - J * I_C * I1) + lam * (J - 1) ** 2 + 8 * mu * (J - 1)


TEST_ONLY = [neo_by_stretches, barrier_by_stretches, hencky, ogden]
TEST_ONLY += [corotational, mooney, second_alone, all_four]
each_extra = pytest.mark.parametrize("function", TEST_ONLY, ids=lambda f: f.__name__)


@lru_cache
def made(function, nu: float = 0.3) -> Material:
    return Material(Energy(function, E=1.7, nu=nu, shape={}))


@pytest.mark.parametrize(
    ("function", "barrier"), [(neo_by_stretches, False), (barrier_by_stretches, True)]
)
@every_kind
def test_by_stretches_or_by_invariants_is_the_same(function, barrier, kind):
    """The same energy through both halves of the code generator, near-equal stretches included."""
    a, b = made(function), law("stable_neo_hookean", 0.3, barrier=barrier)
    F = deformations(KINDS[kind], seed=8)
    if kind.startswith("signed"):  # once rotated, their J is lost in the rounding of F
        F = KINDS[kind][:, :, None] * np.eye(3)
    assert a.energy(F) == pytest.approx(b.energy(F), rel=1e-12, abs=1e-13)
    size = np.linalg.norm(F, axis=(1, 2)) * spread(b.hessian(F)) + np.linalg.norm(b.pk1(F))
    assert np.all(abs(a.pk1(F) - b.pk1(F)) <= 1e-13 * size[:, None, None])
    for filter in FILTERS:
        H = b.hessian(F, filter)
        size = spread(b.hessian(F))[:, None, None]
        assert np.all(abs(a.hessian(F, filter) - H) <= 1e-9 * size)


@each_extra
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
    """Against 60 digits: ten digits where a division by s_j - s_k would leave none."""
    m = made(function)
    F = np.diag(sigma)
    s = svd(F)[1]
    assert_eigenvalues(m, s, m.eigensystem(inside(m, F))[0], 1e-10)


@each_extra
def test_extra_energies_as_any_material(function):
    """Order of convergence, filters and rest, through what an energy of the stretches exercises."""
    m = made(function)
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
    assert m.lame == pytest.approx(law("neo_hookean", 0.3).lame, rel=1e-10)
    F = deformations(np.random.default_rng(2).uniform(-2, 2, (200, 3)))
    H = m.hessian(F)
    size = spread(H)[:, None, None]
    assert np.all(abs(m.hessian(F, "clamp") - filtered(H, "clamp")) <= 1e-14 * size)
