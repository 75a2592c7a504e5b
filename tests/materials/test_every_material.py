"""What is asked of every material: energy, stress, Hessian and filters at any stretches."""

from __future__ import annotations

import numpy as np
import pytest
from points import (
    NO_ENERGY,
    STATES,
    deformations,
    every_name,
    exact_eigenvalues,
    filtered,
    make,
    needs_stretches,
    observed_order,
    spread,
    vec,
)

from fem_snh.choices import EIGENSOLVERS
from fem_snh.errors import BadInput
from fem_snh.kernels.material import Material, svd

NU = 0.3
#: Regular, equal, near-equal and collapsed stretches, then inverted ones.
UPRIGHT = [
    STATES["random"],
    STATES["stretched"],
    STATES["nearly singular"],
    (1.3, 1.3, 0.7),
    (0.8, 0.8, 0.8),
]
UPRIGHT += [(1.3 + 1e-9, 1.3, 0.7), (1.1 + 1e-6, 1.1, 1.1 - 1e-6), (1.2, 1e-2, 1e-2), (2, 1, 1e-5)]
INVERTED = [STATES["inverted"], STATES["all negative"], (1.1, 1.0, -0.9), (1.2, 0.5, -1e-3)]

NO_REST = {"mooney_length", "neo_hookean_wang"}
FINITE = {
    "arap", "c2_neo_hookean", "corotational", "filtered_neo_hookean", "fixed_corotational",
    "gamma_model", "mooney_length", "stable_arruda_boyce", "stable_fung", "stable_neo_hookean",
    "stvk", "stvk_kikuuwe",
}  # fmt: skip
#: The limit of the isochoric I1 - 3, or of its mean with I2 - 3, for the default parameters.
LOCKING = {"extended_tube": 0.09693**-2, "gent": 77.931, "van_der_waals": 10.24**2 - 3}
#: An energy of the stretches divides differences of its stresses (divided_differences.h).
DIGITS = {True: 1e-9, False: 1e-12}


def states(m: Material) -> np.ndarray:
    """The stretches that are in the domain of m."""
    chosen = UPRIGHT if m.name not in LOCKING else [s for s in UPRIGHT if min(s) > 0.02]
    return np.array(chosen + (INVERTED if m.expression.inversion_safe else []))


@every_name
def test_it_is_what_it_says(name):
    """Where it is finite, whether it rests, whether it has an energy."""
    m = make(name, NU)
    assert m.expression.inversion_safe == (name in FINITE)
    assert m.expression.has_energy == (name not in NO_ENERGY)
    assert m.expression.needs_stretches == needs_stretches(name)
    assert (abs(m.expression.rest_stress) > 1e-3 * m.expression.E) == (name in NO_REST)
    rest = m.pk1(np.eye(3))
    assert rest == pytest.approx(m.expression.rest_stress * np.eye(3), abs=1e-14 * m.expression.E)
    if m.expression.has_energy:
        assert m.energy(np.eye(3)) == pytest.approx(0, abs=1e-15 * m.expression.E)
    else:
        with pytest.raises(BadInput, match="has no energy"):
            m.energy(np.eye(3))


@pytest.mark.one_debian
@every_name
def test_derivatives_by_order_of_convergence(name):
    """Central differences of psi tend to P, and of P to the Hessian, as h^2 until rounding."""
    m = make(name, NU)
    chosen = ["random", "stretched", *(["inverted"] if m.expression.inversion_safe else [])]
    h = 0.02 * 2.0 ** -np.arange(9)
    for state in chosen:
        F = deformations(STATES[state], seed=7)
        D = np.random.default_rng(8).standard_normal((3, 3))
        D /= np.linalg.norm(D)
        points = F + h[:, None, None] * D, F - h[:, None, None] * D
        if m.expression.has_energy:
            up, down = (m.energy(x) for x in points)
            error = abs((up - down) / (2 * h) - (m.pk1(F) * D).sum())
            size = abs(m.energy(F)) + np.linalg.norm(m.pk1(F)) * np.linalg.norm(F) + m.expression.E
            assert observed_order(h, error, 1e-16 * size / h) == pytest.approx(2, abs=0.2)
        elif state == "inverted":
            continue  # the derivative of its stress is not symmetric: see below
        up, down = (vec(m.pk1(x)) for x in points)
        error = np.linalg.norm((up - down) / (2 * h[:, None]) - m.hessian(F) @ vec(D), axis=1)
        size = np.linalg.norm(m.pk1(F)) + np.linalg.norm(m.hessian(F)) * np.linalg.norm(F)
        assert observed_order(h, error, 1e-16 * size / h) == pytest.approx(2, abs=0.2)


@every_name
def test_stress_and_eigenvalues_against_sixty_digits(name):
    m = make(name, NU)
    for sigma in states(m):
        F = np.diag(sigma)
        first, expected = exact_eigenvalues(m, svd(F)[1])
        values, _ = m.eigensystem(F)
        bound = DIGITS[m.expression.of_stretches]
        assert abs(values - expected).max() <= bound * abs(expected).max()
        P, first = np.linalg.svd(m.pk1(F), compute_uv=False), np.sort(abs(first))[::-1]
        assert P == pytest.approx(first, abs=1e-12 * (1 + first[0]))


@pytest.mark.one_debian
@every_name
def test_eigensystem_and_filters_against_eigh(name):
    """The closed form diagonalises the Hessian; filters are those of eigh, and semidefinite."""
    m = make(name, NU)
    F = deformations(states(m), seed=3)
    H = m.hessian(F)
    size = spread(H)[:, None, None]
    for solver in EIGENSOLVERS:
        values, vectors = m.eigensystem(F, solver)
        assert np.all(abs(H @ vectors - vectors * values[:, None, :]) <= 3e-14 * size)
        assert abs(np.swapaxes(vectors, 1, 2) @ vectors - np.eye(9)).max() <= 1e-14
        for filter in ("clamp", "abs"):
            found = m.hessian(F, filter, solver)
            assert np.all(abs(found - filtered(H, filter)) <= 1e-14 * size)
            assert np.all(np.linalg.eigvalsh(found / size) >= -1e-14)


@every_name
def test_outside_the_domain(name):
    """Energy +inf and all else zero where it is infinite; nothing is ever NaN."""
    m = make(name, NU)
    F = np.concatenate(
        [deformations(np.array(INVERTED)), np.zeros((1, 3, 3)), [np.full((3, 3), np.nan)]]
    )
    parts = [m.pk1(F), m.hessian(F), m.hessian(F, "clamp"), m.eigensystem(F)[0]]
    assert all(np.isfinite(part).all() for part in parts)
    if not m.expression.has_energy:
        return
    psi = m.energy(F)
    assert not np.isnan(psi).any() and psi[-1] == np.inf
    assert (
        np.isfinite(psi[:-1]).all() if m.expression.inversion_safe else (psi[:-1] == np.inf).all()
    )
    outside = np.isinf(psi)
    assert not any(part[outside].any() for part in parts)


@pytest.mark.parametrize("name", LOCKING)
def test_no_chain_is_longer_than_its_contour(name):
    """The energy is +inf from the limit of the isochoric stretch on, stress and Hessian are 0."""
    m = make(name, NU)
    beta = m.numbers.shape["beta"] if name == "van_der_waals" else 0
    t = np.linspace(5, 12, 71)
    x = (1 - beta) * (t**2 + 2 / t) + beta * (2 * t + t**-2) - 3
    inside = x < LOCKING[name]
    assert 20 < inside.sum() < 60
    F = 1.1 * np.stack([np.diag([s, s**-0.5, s**-0.5]) for s in t])  # the volume does not matter
    psi = m.energy(F)
    assert np.isfinite(psi[inside]).all() and (psi[~inside] == np.inf).all()
    assert not m.pk1(F[~inside]).any() and not m.hessian(F[~inside]).any()
    assert (np.diff(m.pk1(F[inside])[:, 0, 0]) > 0).all()


def test_a_stress_that_is_no_gradient():
    """filtered_neo_hookean: below the threshold the derivative of P is not symmetric; ours is."""
    m = make("filtered_neo_hookean", NU)
    F, h = np.diag([1.4, 0.9, 0.1]), 1e-6
    jacobian = np.array(
        [
            (vec(m.pk1(F + h * D)) - vec(m.pk1(F - h * D))) / (2 * h)
            for D in np.swapaxes(np.eye(9).reshape(9, 3, 3), 1, 2)
        ]
    ).T
    assert abs(jacobian - jacobian.T).max() > 0.1 * m.expression.E
    assert m.hessian(F) == pytest.approx((jacobian + jacobian.T) / 2, abs=1e-7)
