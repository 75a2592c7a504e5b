"""The elastic energy by FFCx's forms: energy and residual are those of the kernels."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import cube, norm

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Region
from fem_snh.kernels.material import material
from fem_snh.terms.elastic import Elastic
from fem_snh.terms.elastic_forms import ElasticForms

#: Relative difference of energies and of residuals.
BOUND = 1e-12
#: Unit of the pressure unknown [Pa/m].
SCALE = 2.0

#: Element, materials of as many regions, largest displacement of a node [cell sizes].
CASES = {
    "P1 of stretches": ("P1", [("hencky", 0.3), ("stable_neo_hookean", 0.3)], 0.05),
    "P2 inverted": ("P2", [("stable_neo_hookean", 0.45)], 0.5),
    "Q1 in regions": ("Q1", [("stable_neo_hookean", 0.3), ("neo_hookean", 0.3)], 0.05),
    "P2P0 in regions": ("P2P0", [("neo_hookean", 0.45), ("stable_neo_hookean", 0.49)], 0.05),
    "Q1P0": ("Q1P0", [("stable_neo_hookean", 0.499)], 0.3),
    "P2P1": ("P2P1", [("stable_neo_hookean", 0.4999)], 0.2),
    "Q2Q1": ("Q2Q1", [("stable_neo_hookean", 0.5)], 0.2),
}
ON_RANKS = ("Q1 in regions", "P2P0 in regions", "P2P1")


def spaces(comm: MPI.Comm, name: str) -> Any:
    """Displacement and pressure space of an element on 2 x 2 x 2 bent cells."""
    kind = ELEMENTS[name]
    domain = cube(comm, kind.cell, 2, 0.05).domain
    V = _dolfinx.function_space(domain, kind.degree, (3,))
    Q = None
    if kind.volume == "pressure":
        Q = _dolfinx.function_space(domain, kind.pressure_degree)
    return V, Q


def halves(V: Any, materials: list[Any]) -> list[Region]:
    """One region for each material: the first cells, and the others."""
    cells = np.arange(len(_dolfinx.node_dofs(V)), dtype=np.int32)
    return [
        Region(m, part)
        for m, part in zip(materials, np.array_split(cells, len(materials)), strict=True)
    ]


def random(space: Any, size: float, seed: int) -> Any:
    """A ghosted vector of random numbers, ghosts up to date."""
    x = _dolfinx.create_vector(space)
    numbers = np.random.default_rng(10 * seed + space.mesh.comm.rank)
    x.array[:] = numbers.uniform(-size, size, x.getLocalSize())
    x.ghostUpdate()
    return x


def residual(term: Any, u: Any, p: Any, V: Any, Q: Any) -> list[Any]:
    """dE/du and dE/dp, summed over the ranks."""
    found = [_dolfinx.create_vector(space) for space in (V, Q) if space]
    term.add_residual(u, p, found[0], found[1] if Q else None)
    for r in found:
        r.ghostUpdate(addv=True, mode=True)
    return [r.array.copy() for r in found]


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize(
    "case",
    [pytest.param(case, marks=[pytest.mark.mpi] if case in ON_RANKS else []) for case in CASES],
)
def test_energy_and_residual(comm, case):
    element, chosen, size = CASES[case]
    V, Q = spaces(comm, element)
    regions = halves(V, [material(name, E=1.7, nu=nu) for name, nu in chosen])
    kernels, forms = (
        kind(V, ELEMENTS[element], regions, Q, SCALE) for kind in (Elastic, ElasticForms)
    )
    for seed in (1, 2):
        u = random(V, size / 2, seed)
        p = random(Q, 0.3, seed) if Q else None
        expected = kernels.energy(u, p)
        assert np.isfinite(expected)
        assert forms.energy(u, p) == pytest.approx(expected, rel=BOUND)
        for r, r_kernels in zip(
            *(residual(term, u, p, V, Q) for term in (forms, kernels)), strict=True
        ):
            assert norm(comm, r - r_kernels) <= BOUND * norm(comm, r_kernels)


@pytest.mark.mpi
def test_run(comm):
    """A scene with assembly = "ufl" takes the same iterations to the same energy."""
    values = {"nu": 0.45, "cells": 2, "element": "P1", "angle": 0.4, "steps": 1, "progress": False}
    kernels, forms = (
        fem_snh.run("twist", **values, assembly=assembly) for assembly in ("kernels", "ufl")
    )
    assert [r.record["assembly"] for r in (kernels, forms)] == ["kernels", "ufl"]
    (a,), (b,) = kernels.record["steps"], forms.record["steps"]
    assert b["converged"] and b["newton"] == a["newton"]
    assert b["energy"] == pytest.approx(a["energy"], rel=BOUND)
