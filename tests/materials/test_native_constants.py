"""Materials by the constants of the literature: E and nu follow from them."""

from __future__ import annotations

from collections.abc import Callable

import mpmath as mp
import numpy as np
import pytest

import fem_snh
from fem_snh import scenes
from fem_snh.materials.invariants import SIGMA
from fem_snh.materials.making import make_energy
from fem_snh.materials.volume_split import J, split

pytestmark = pytest.mark.one_debian

F = np.array([[1.3, 0.2, -0.1], [0.1, 0.8, 0.3], [-0.2, 0.1, 1.1]])
D1 = 0.04


def invariants(isochoric: bool = True):
    """Return I1, I2, J and the stretches of F in mpmath, of the isochoric part if wanted."""
    A = mp.matrix(F.tolist())
    C, J = A.T * A, mp.det(A)
    size = J ** (-mp.mpf(2) / 3) if isochoric else 1
    squares = [size * x for x in mp.eigsy(C, eigvals_only=True)]
    first = sum(squares)
    second = (first**2 - sum(x**2 for x in squares)) / 2
    return first, second, J, [mp.sqrt(x) for x in squares]


def volume() -> mp.mpf:
    return (invariants()[2] - 1) ** 2 / mp.mpf(D1)


def mooney_rivlin(C10, C01):
    I1, I2, *_ = invariants()
    return C10 * (I1 - 3) + C01 * (I2 - 3) + volume()


def yeoh(C10, C20, C30):
    x = invariants()[0] - 3
    return C10 * x + C20 * x**2 + C30 * x**3 + volume()


def neo_hookean(C10):
    return C10 * (invariants()[0] - 3) + volume()


def gent(mu, J_m):
    x = invariants()[0] - 3
    return -mu * J_m / 2 * mp.log(1 - x / mp.mpf(J_m)) + volume()


def extended_tube(Gc, Ge, delta, beta):
    I1, _, _, s = invariants()
    d, b, x = mp.mpf(delta), mp.mpf(beta), I1 - 3
    links = (1 - d**2) * x / (1 - d**2 * x) + mp.log(1 - d**2 * x)
    return Gc / 2 * links + 2 * Ge / b**2 * sum(t**-b - 1 for t in s) + volume()


def van_der_waals(mu, lambda_m, a, beta):
    I1, I2, *_ = invariants()
    m, x = mp.mpf(lambda_m) ** 2 - 3, (1 - mp.mpf(beta)) * I1 + beta * I2 - 3
    y = mp.sqrt(x / m)
    return mu * (-m * (mp.log(1 - y) + y) - mp.mpf(2) / 3 * a * mp.sqrt(x / 2) ** 3) + volume()


def ogden(mu_p, alpha_p, lam):
    _, _, J, s = invariants(isochoric=False)
    terms = sum(m / a * sum(t**a - 1 for t in s) for m, a in zip(mu_p, alpha_p, strict=True))
    return terms - sum(mu_p) * mp.log(J) + lam / 2 * (J - 1) ** 2


def lame(mu, lam):
    I1, _, J, _ = invariants(isochoric=False)
    return mu / 2 * (I1 - 3) - mu * mp.log(J) + lam / 2 * mp.log(J) ** 2


#: Name, published constants, published energy, small-strain shear modulus.
CASES: list[tuple[str, dict, Callable, float]] = [
    ("mooney_rivlin", {"C10": 0.3, "C01": 0.07}, mooney_rivlin, 0.74),
    ("yeoh", {"C10": 0.2, "C20": -2e-3, "C30": 4e-5}, yeoh, 0.4),
    ("neo_hookean_bower", {"C10": 0.35}, neo_hookean, 0.7),
    ("gent", {"mu": 0.27, "J_m": 80.0}, gent, 0.27),
    ("extended_tube", {"Gc": 0.1867, "Ge": 0.2169, "delta": 0.09693, "beta": 0.2}, extended_tube,
     (1 - 2 * 0.09693**2) * 0.1867 + 0.2169),
    ("van_der_waals", {"mu": 0.434, "lambda_m": 10.24, "a": 0.32, "beta": 0.042}, van_der_waals,
     0.434),
    ("ogden", {"mu_p": [0.63, 0.0012, -0.01], "alpha_p": [1.3, 5.0, -2.0], "lam": 20.0}, ogden,
     0.4225),
    ("neo_hookean", {"mu": 0.4, "lam": 3.0}, lame, 0.4),
]  # fmt: skip


@pytest.mark.parametrize(("name", "native", "energy", "mu"), CASES, ids=[c[0] for c in CASES])
def test_the_energy_is_the_published_one(name, native, energy, mu):
    given = native if "lam" in native else native | {"D1": D1}
    m = fem_snh.material(name, **given)
    with mp.workdps(40):
        assert m.energy(F) == pytest.approx(float(energy(**native)), rel=1e-12)
    assert m.lame[0] == pytest.approx(mu, rel=1e-12)
    if "lam" not in native:
        assert m.lame[1] + 2 / 3 * mu == pytest.approx(2 / D1, rel=1e-12)
    # A scene has the same, and its record E and nu.
    table = scenes.load("stretch", material={"name": name} | given).material
    assert (table.E, table.nu) == (m.numbers.E, m.numbers.nu)
    again = fem_snh.material(name, table.E, table.nu, **table.parameters)
    assert again.energy(F) == pytest.approx(m.energy(F), rel=1e-14)


def test_new_constants_replace_what_they_determine():
    """E and nu of a scene, an older D1; what they leave open remains."""
    given = {"material": "mooney_rivlin", "material.C10": 0.3, "material.C01": 0.1}
    scene = scenes.load("stretch", **given, **{"material.D1": D1})
    assert scene.material.E == pytest.approx(9 * 50 * 0.8 / 150.8, rel=1e-14)
    softer = scenes.load(scene, **{"material.D1": 2 * D1})
    assert softer.material.E == pytest.approx(9 * 25 * 0.8 / 75.8, rel=1e-14)
    ogden = {"name": "ogden", "mu_p": [0.6, -0.1], "alpha_p": [2.0, -2.0], "nu": 0.45}
    stiffer = scenes.load(scenes.load("stretch", material=ogden), **{"material.mu_p": [1.2, -0.2]})
    assert stiffer.material.E == pytest.approx(2 * 1.45 * 1.4, rel=1e-14)
    gent = scenes.load("stretch", material="gent", **{"material.mu": 0.4})
    assert (gent.material.E, gent.material.nu) == (pytest.approx(2 * 1.49 * 0.4), 0.49)
    rubber = scenes.load("stretch", material="mooney_rivlin", **{"material.C2": 0.1}, E=2)
    assert rubber.material.E == 2


def test_a_scene_runs_with_them():
    """An incompressible body: the volume term leaves, C10 and C01 remain in the kernels."""
    given = {"material": "mooney_rivlin", "material.C10": 0.3, "material.C01": 0.1}
    given["material.D1"] = 0
    result = fem_snh.run("pull", cells=1, element="P2P1", steps=1, **given)
    assert result.converged
    assert result.record["material"]["E"] == pytest.approx(2.4)
    assert result.steps[-1]["volume_ratio"] == pytest.approx(1, abs=1e-6)


#: Published constants of every material that has some, with Poisson's ratio.
WITH_NU = {
    "mooney_rivlin": {"C10": 0.3, "C01": 0.1},
    "ogden": {"mu_p": [0.63, 0.0012, -0.01], "alpha_p": [1.3, 5, -2]},
    "gent": {"mu": 0.3, "J_m": 80},
    "yeoh": {"C10": 0.2, "C20": -0.002, "C30": 5e-5},
    "extended_tube": {"Gc": 0.2, "Ge": 0.15},
    "van_der_waals": {"mu": 0.3, "lambda_m": 10.0, "a": 0.2},
}


@pytest.mark.parametrize("name", WITH_NU)
def test_published_constants_and_nu_in_mixed_elements(name):
    """The parts of the split are the energy, also with E and nu beside the constants."""
    first = make_energy(name, nu=0.49, **WITH_NU[name])
    energy = make_energy(name, first.E, first.nu, **WITH_NU[name])
    for bound in (2.0, 4.0):
        parts = split(energy, bound)
        rest = parts.deviatoric
        numbers = dict(zip(rest.constants, rest.values, strict=True))
        whole = dict(zip(energy.constants, energy.values, strict=True))
        stretches = dict(zip(SIGMA, (1.2, 1.0, 0.9), strict=True))
        found = rest.psi_sigma.subs(numbers).subs(stretches)
        found += parts.volume.subs(numbers).subs(J, 1.2 * 0.9)
        expected = energy.psi_sigma.subs(whole).subs(stretches)
        assert float(found) == pytest.approx(float(expected), rel=1e-8)
