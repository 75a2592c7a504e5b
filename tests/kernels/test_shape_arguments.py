"""Shape parameters as arguments of the kernels: how many libraries there are, and their values."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from points import STATES, compare, deformations

import fem_snh
from fem_snh import cli, materials
from fem_snh.choices import POINT_FILTERS
from fem_snh.kernels.codegen import source
from fem_snh.kernels.material import Material, compile_kernel
from fem_snh.materials.runtime import with_arguments

NU = 0.3
#: Stretches of both branches, and near rest.
STRETCHES = np.array(
    [STATES["random"], (1.3, 1.3, 0.7), (1.1 + 1e-6, 1.1, 1.1 - 1e-6), (1 + 1e-7, 1 - 2e-7, 1.0)]
)
#: Those whose kernels the tests compile.
EVALUATED: list[tuple[str, dict[str, Any]]] = [
    ("symmetric_seth_hill", {"n": -1.3}),
    ("stable_neo_hookean", {"alpha": 1.37}),
    ("ogden", {"exponents": (1.2, 5.0, -1.8), "weights": (6.0, 0.01, -0.2)}),
    ("gent", {"J_m": 50.0, "alpha": 1.2}),
    ("extended_tube", {"delta": 0.1, "beta": 0.3}),
]


@pytest.fixture
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """An empty cache."""
    monkeypatch.setenv("FEM_SNH_CACHE", str(tmp_path / "cache"))
    return tmp_path / "cache"


def compiled(folder: Path) -> int:
    """Return the number of materials that are compiled in the cache."""
    return sum("/* generated:" in source.read_text() for source in folder.glob("*.c"))


def made(name: str, shape: dict[str, Any]) -> Material:
    given = dict(shape)
    nu = given.pop("nu", NU)
    moduli = {"nu": nu} if "mu_p" in given else {"E": 1.7, "nu": nu}
    return fem_snh.material(name, **moduli, **given)


def with_literals(m: Material, monkeypatch: pytest.MonkeyPatch) -> Material:
    """Return the material with all its numbers compiled in."""
    literal = Material.of(m.expression)
    with monkeypatch.context() as patch:
        patch.setattr(source, "with_arguments", lambda energy: energy)
        literal.energy(np.eye(3))
    return literal


@pytest.mark.parametrize(("name", "shape"), EVALUATED, ids=str)
def test_values_are_those_of_fifty_digits(name: str, shape: dict[str, Any]) -> None:
    """The rounding of the parameter to a double is included."""
    m, rng = made(name, shape), np.random.default_rng(2)
    for F in deformations(STRETCHES, seed=5):
        assert max(c.ratio for c in compare(m, F, rng)) <= 1


@pytest.mark.one_debian
@pytest.mark.parametrize(("name", "shape"), EVALUATED[:2], ids=str)
def test_values_are_those_of_compiled_in_parameters(
    name: str, shape: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    m = made(name, shape)
    literal, F = with_literals(m, monkeypatch), deformations(STRETCHES, seed=3)
    assert literal.energy(F) == pytest.approx(m.energy(F), rel=1e-12, abs=1e-15)
    pairs = [(m.pk1(F), literal.pk1(F))]
    pairs += [(m.hessian(F, f), literal.hessian(F, f)) for f in POINT_FILTERS]
    for one, other in pairs:
        error = np.abs(one - other).max(axis=(1, 2))
        assert np.all(error <= 1e-11 * np.abs(other).max(axis=(1, 2)) + 1e-15)  # rounding of F


@pytest.mark.one_debian
def test_one_library_serves_all_values(folder: Path) -> None:
    for n in (0.7, 0.8, 0.93, 5.3, -1.2):
        for nu in (0.2, 0.3):
            compile_kernel(fem_snh.material("seth_hill", 2.0, nu, n=n))
    assert compiled(folder) == 1
    for n in (0.5, 1, 2):  # the default and values with other domains
        compile_kernel(fem_snh.material("seth_hill", n=n))
    assert compiled(folder) == 4


@pytest.mark.parametrize("volume", ["mean", "pressure"])
def test_elements_with_pressures(folder: Path, volume: str) -> None:
    found = [
        compile_kernel(fem_snh.material("stable_fung", nu=0.49, gamma=g), volume)
        for g in (0.2, 0.3, 0.4)
    ]
    assert compiled(folder) == 1 == len({c.path for c in found})
    assert [c.constants.values[3:] for c in found] == [(0.2,), (0.3,), (0.4,)]
    local = [c.constants.lambda_local for c in found]
    assert local == pytest.approx(local[:1] * 3, rel=1e-14)


def special_at_two(I_C: Any, J: Any, mu: Any, lam: Any, *, k: float = 1.0) -> Any:
    stiff = 0.3 if k == 2 else k / 10
    base = mu / 2 * (I_C - 3) - mu * (J - 1) + lam / 2 * (J - 1) ** 2
    return base + stiff * mu * (I_C - 3) ** 2


@pytest.mark.one_debian
def test_a_function_that_treats_a_value_differently() -> None:
    """A symbol does not show that branch; a comparison with the numbers does."""
    assert with_arguments(materials.make_energy(special_at_two, k=1.5)).parameters
    assert not with_arguments(materials.make_energy(special_at_two, k=2.0)).parameters
    F = np.diag([1.3, 1.0, 0.9])
    energies = [fem_snh.material(special_at_two, k=k).energy(F) for k in (1.0, 2.0, 3.0)]
    assert energies[1] == pytest.approx(energies[2], rel=1e-14)
    assert energies[0] < energies[1]


@pytest.mark.one_debian
def test_a_sweep_compiles_once(folder: Path, tmp_path: Path) -> None:
    words = ["sweep", "pull", "--material", "seth_hill", "--set", "material.n=0.7,0.8,0.9",
             "--set", "cells=1", "--set", "steps=1", "--out", str(tmp_path / "sweep")]  # fmt: skip
    assert cli.main(words) == 0
    assert compiled(folder) == 1
