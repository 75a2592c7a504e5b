"""Stresses in homogeneous deformations against exact solutions, derived here."""

from __future__ import annotations

import mpmath
import numpy as np
import pytest
import sympy

import fem_snh
from fem_snh.materials.invariants import positive
from fem_snh.studies.fit.data import TESTS
from fem_snh.studies.fit.family import Family
from fem_snh.studies.fit.responses import FREE, response, stretches

pytestmark = pytest.mark.one_debian

X = np.array([0.4, 0.8, 1.0, 1.5, 3.0])
NU = 0.3
MU, LAM = 1 / (2 * (1 + NU)), NU / ((1 + NU) * (1 - 2 * NU))
K = LAM + 2 / 3 * MU


def law(name: str, nu: float | None = None, **held: object):  # type: ignore[no-untyped-def]
    family = Family(name, nu is None, nu or 0.5, held)
    return family.at(family.start, nu)


@pytest.mark.parametrize("name", ["neo_hookean", "stable_neo_hookean", "neo_hookean_simo"])
def test_incompressible_neo_hookean(name: str) -> None:
    """P = mu (x - x^-2), mu (x - x^-5), mu (x - x^-3), mu gamma."""
    for kind, power in (("uniaxial", -2), ("equibiaxial", -5), ("planar", -3)):
        assert response(law(name), kind, X) == pytest.approx((X - X**power) / 3, rel=1e-13)
    gamma = np.array([-1.0, 0.0, 0.5, 4.0])
    assert response(law(name), "simple_shear", gamma) == pytest.approx(gamma / 3, rel=1e-13)


@pytest.mark.parametrize("nu", [None, NU])
@pytest.mark.parametrize("name", ["ogden", "stable_fung", "hencky"])
def test_planar_and_equibiaxial_tests_are_biaxial(name: str, nu: float | None) -> None:
    """With y = 1 and y = x; the true stresses are s P/J, and equal in the equibiaxial test."""
    m = law(name, nu)
    for kind, y in (("planar", np.ones_like(X)), ("equibiaxial", X)):
        P = response(m, "biaxial", X, y)
        assert response(m, kind, X) == pytest.approx(P, rel=1e-15, abs=1e-15, nan_ok=True)
        s = stretches(m, kind, X)
        sigma = X * P - y * response(m, "biaxial", X, y, "stress_2")
        difference = response(m, "biaxial", X, y, "stress_difference")
        assert difference == pytest.approx(sigma / s.prod(axis=1), abs=1e-13, nan_ok=True)
    assert np.isfinite(P).sum() >= 3
    assert difference == pytest.approx(0 * X, abs=1e-14, nan_ok=True)


@pytest.mark.parametrize("name", ["ogden", "stable_fung", "mooney_rivlin", "neo_hookean_simo"])
def test_free_stretches_by_mpmath(name: str) -> None:
    """The lateral stretch that makes the stress of the energy vanish, by mpmath's root finder."""
    made = fem_snh.materials.make_energy(name, 1.0, NU)
    psi = made.psi_sigma
    x = 1.7
    s0, s1, s2 = sympy.symbols("s0 s1 s2", real=True)
    values = dict(zip(made.constants, made.values, strict=True))
    stress = [
        sympy.lambdify(
            (s0, s1, s2),
            sympy.diff(psi, s).subs(values).replace(positive, lambda e: e),
            modules="mpmath",
        )
        for s in (s0, s2)
    ]
    for kind in FREE:

        def sides(t, kind=kind):  # type: ignore[no-untyped-def]
            return {"uniaxial": (x, t, t), "equibiaxial": (x, x, t), "planar": (x, 1, t)}[kind]

        t = mpmath.findroot(lambda t, sides=sides: stress[1](*sides(t)), 0.8)
        held = {"C1": made.values[0]} if name == "mooney_rivlin" else {}
        m = law(name, NU, **held)
        found = stretches(m, kind, np.array([x]))[0, 2]
        assert found == pytest.approx(float(t), rel=1e-11)
        assert response(m, kind, np.array([x]))[0] == pytest.approx(
            float(stress[0](*sides(t))), rel=1e-10
        )


def test_every_material_has_a_response() -> None:
    """Slope E, E/(1 - nu), E/(1 - nu^2), 3 K, lam + 2 mu, mu at rest, or a reason."""
    slopes = {
        "uniaxial": 1.0, "equibiaxial": 1 / (1 - NU), "planar": 1 / (1 - NU**2),
        "simple_shear": MU, "volumetric": 3 * K, "confined": LAM + 2 * MU,
        "biaxial": 1 / (1 - NU**2),
    }  # fmt: skip
    assert set(slopes) == set(TESTS)
    h = 1e-5
    for name in fem_snh.materials():
        try:
            m = law(name, NU)
        except fem_snh.BadInput as error:
            assert name in ("mooney_length", "neo_hookean_wang"), error
            continue
        for kind, slope in slopes.items():
            rest = 0.0 if kind == "simple_shear" else 1.0
            P = response(m, kind, np.array([rest + h, rest - h]), np.ones(2))
            assert (P[0] - P[1]) / (2 * h) == pytest.approx(slope, rel=1e-5), (name, kind)
