"""Energies of rubber: published constants against Treloar's data, closed forms and derivatives."""

from __future__ import annotations

import numpy as np
import pytest

import fem_snh

pytestmark = pytest.mark.one_debian

#: Treloar 1944, 20 degrees, uniaxial tension: stretch and nominal stress [kg/cm^2], as tabulated
#: by Steinmann, Hossain & Possart 2012.
STRETCH = np.array(
    [1.12, 1.24, 1.39, 1.61, 1.89, 2.17, 2.42, 3.01, 3.58, 4.03, 4.76, 5.36, 5.76, 6.16, 6.40, 6.62,
     6.87, 7.05, 7.16, 7.27, 7.43, 7.50, 7.61]
)  # fmt: skip
NOMINAL = np.array(
    [1.37, 2.30, 3.23, 4.16, 5.10, 6.00, 6.90, 8.80, 10.7, 12.5, 16.2, 19.9, 23.6, 27.4, 31.0, 34.8,
     38.5, 42.1, 45.8, 49.6, 53.3, 57.1, 64.4]
)  # fmt: skip
#: One kg/cm^2 in MPa.
KG = 0.0980665
NU = 0.4999


def uniaxial(m: fem_snh.Material, t: np.ndarray) -> np.ndarray:
    """Return the nominal stress of an incompressible bar: the pressure makes its sides free."""
    F = np.stack([np.diag([s, s**-0.5, s**-0.5]) for s in t])
    P = m.pk1(F)
    return P[:, 0, 0] - P[:, 1, 1] * t**-1.5


def modulus(mu: float) -> float:
    """Return Young's modulus of a shear modulus."""
    return 2 * mu * (1 + NU)


def made(name: str) -> fem_snh.Material:
    """Return a material with its published constants for Treloar's rubber [MPa]."""
    if name == "gent":  # Ogden, Saccomandi & Sgura 2004
        return fem_snh.material("gent", E=modulus(2.4195 * KG), nu=NU, J_m=77.931)
    if name == "extended_tube":  # Kaliske & Heinrich 1999
        delta = 0.09693
        E = modulus((1 - 2 * delta**2) * 0.1867 + 0.2169)
        return fem_snh.material(name, E=E, nu=NU, Gc=0.1867, delta=delta, beta=0.2)
    # Marckmann & Verron 2006
    return fem_snh.material(name, E=modulus(0.434), nu=NU, lambda_m=10.24, a=0.32, beta=0.042)


@pytest.mark.parametrize(
    ("name", "worst"), [("gent", 0.015), ("extended_tube", 0.014), ("van_der_waals", 0.02)]
)
def test_published_constants_give_treloar_s_stresses(name, worst):
    """Root mean square of the error, relative to the largest stress."""
    error = uniaxial(made(name), STRETCH) - NOMINAL * KG
    assert np.sqrt(np.mean(error**2)) <= worst * NOMINAL[-1] * KG


def test_yeoh_s_constants_from_treloar_s_data():
    """The stress is linear in C10, C20, C30: numpy fits them, the program agrees."""
    I1, t = STRETCH**2 + 2 / STRETCH, STRETCH
    terms = [2 * (t - t**-2) * k * (I1 - 3) ** (k - 1) for k in (1, 2, 3)]
    C10, C20, C30 = np.linalg.lstsq(np.stack(terms, 1), NOMINAL * KG, rcond=None)[0]
    m = fem_snh.material("yeoh", E=modulus(2 * C10), nu=NU, C20=C20, C30=C30)
    assert m.numbers.values[:3] == pytest.approx((C10, C20, C30), rel=1e-12)
    stress = uniaxial(m, t)
    assert stress == pytest.approx(C10 * terms[0] + C20 * terms[1] + C30 * terms[2], rel=1e-12)
    assert np.sqrt(np.mean((stress / KG - NOMINAL) ** 2)) <= 0.02 * NOMINAL[-1]
    default = fem_snh.material("yeoh", E=modulus(2 * C10), nu=NU).numbers.values
    assert default[:3] == pytest.approx((C10, C20, C30), rel=0.01)
