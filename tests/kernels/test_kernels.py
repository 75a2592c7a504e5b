"""The kernels at single points: derivatives, references in many digits, invariance."""

from __future__ import annotations

import hypothesis.strategies as st
import mpmath
import numpy as np
import pytest
import sympy
from hypothesis import assume, given
from hypothesis.extra.numpy import arrays
from points import (
    PAIRS,
    STATES,
    assert_eigenvalues,
    deformations,
    every_material,
    is_outside_domain,
    make,
    rotations,
    vec,
)

from benchmarks.eigensolvers import paper_terms
from fem_snh.kernels.material import Material, svd
from fem_snh.materials.energy import Energy

# --- references in many digits -------------------------------------------------------------------


def exactly(A: np.ndarray) -> mpmath.matrix:
    """An array as a matrix of mpmath."""
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


@pytest.mark.parametrize("state", STATES)
@every_material
def test_energy_stress_and_hessian_with_80_digits(m, state):
    """Reference: differences of the energy in 80 digits, exact to 25 digits."""
    m = make(*m)
    F = deformations(STATES[state], seed=3)
    if is_outside_domain(m, F):
        return
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
            size = np.linalg.norm(H) * np.linalg.norm(A) * 3
            assert abs(found - float(curvature)) <= 1e-13 * size


NEAR = [1e-3, 1e-5, 1e-6, 1e-8, 1e-12, 1e-15]


@every_material
@pytest.mark.parametrize(
    "sigma",
    [*STATES.values(), *[(1.3, 1.3 - d, 0.7) for d in NEAR], *[(1.1 + d, 1.1, 1.1) for d in NEAR]],
)
def test_eigenvalues_with_60_digits(m, sigma):
    """Reference: sympy's derivatives in the stretches, nearly equal ones too."""
    m = make(*m)
    F = np.diag(sigma)
    if is_outside_domain(m, F):
        return
    s = svd(F)[1]
    values, _ = m.eigensystem(F)
    assert_eigenvalues(m, s, values, 1e-13)


# --- invariance ----------------------------------------------------------------------------------

entries = st.floats(-2, 2, allow_subnormal=False)
gradients = arrays(float, (3, 3), elements=entries)
turns = st.integers(0, 999).map(lambda seed: rotations(1, seed)[0])


def rounding(m: Material, F: np.ndarray) -> tuple[float, float, float]:
    """Bounds on the change of psi, P and Hessian by the rounding of F."""
    size = np.linalg.norm(F) + 1e-30
    P, H = np.linalg.norm(m.pk1(F)), np.linalg.norm(m.hessian(F))
    E = m.expression.E / (1 - 2 * m.expression.nu)
    return 1e-13 * (E + m.energy(F) + P * size), 1e-13 * (E + P + H * size), 1e-13 * (E + H)


@every_material
@given(F=gradients, Q=turns)
def test_frame_invariance_and_isotropy(m, F, Q):
    """psi(QF) = psi(FQ) = psi(F), P(QF) = Q P(F), P(FQ) = P(F) Q."""
    m = make(*m)
    assume(abs(np.linalg.det(F)) > 1e-3)  # rounding must not decide whether psi is finite
    psi, P = m.energy(F), m.pk1(F)
    if np.isinf(psi):
        assert np.isinf(m.energy(Q @ F))
        assert np.isinf(m.energy(F @ Q))
        return
    s = svd(F)[1]
    assume(not m.expression.needs_stretches or s[1] + s[2] > 1e-3)  # or the rotation jumps
    of_psi, of_P, _ = rounding(m, F)
    for turned in (Q @ F, F @ Q):
        assert abs(m.energy(turned) - psi) <= of_psi
    assert abs(m.pk1(Q @ F) - Q @ P).max() <= of_P
    assert abs(m.pk1(F @ Q) - P @ Q).max() <= of_P


@pytest.mark.parametrize("nu", [0.3, 0.49])
@given(F=gradients, order=st.permutations(range(3)), mirror=st.integers(0, 2))
def test_hessian_is_independent_of_the_convention_of_the_svd(nu, F, order, mirror):
    """Smith et al. 2018, eq. 41, with any order and signs of the stretches."""
    m = make("stable_neo_hookean", nu)
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
    """gamma_I, gamma_H, gamma_H eta, gamma_H rho of Smith et al. 2018; finite at gamma_H = 0."""
    gamma_I, gamma_H, _, _ = paper_terms(m, s.astype(object) + sympy.Rational(0))
    mu, lam = m.expression.values
    I_C = (s**2).sum()
    eta_H = 2 * mu / (I_C + 1) ** 2 if m.expression.nu < 0.4 else 0.0
    return float(gamma_I), float(gamma_H), eta_H, lam
