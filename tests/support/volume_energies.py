"""Volume terms by hand, and problems of elements that treat them apart, for their tests."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest
import ufl
from bodies import MATERIALS, Hold, create_problem, cube, wave

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS, with_cell_pressures
from fem_snh.kernels.material import material

mpi = pytest.mark.mpi
MIXED = [name for name, e in ELEMENTS.items() if e.volume != "pointwise"]
MEAN = [name for name in MIXED if ELEMENTS[name].volume == "mean"]
TAYLOR_HOOD = [name for name in MIXED if ELEMENTS[name].volume == "pressure"]


@dataclass(frozen=True)
class Volume:
    """U(J), which takes the material's lambda from lambda_local to lambda: k = their difference.

    curve : (U, U', U'') at J.
    rest : psi', the energy without U, in UFL, from F, mu_lame and lambda_local, where there is one.
    """

    curve: Callable
    rest: Callable | None = None


def quadratic(J, k):
    return k / 2 * (J - 1) ** 2, k * (J - 1), k + 0 * J


def logarithmic(J, k):
    return k / 2 * np.log(J) ** 2, k * np.log(J) / J, k * (1 - np.log(J)) / J**2


def stable(F, mu, local):
    """eq. 13, mu = mu_lame, lambda = lambda_lame + mu_lame."""
    J = ufl.det(F)
    return mu / 2 * (ufl.inner(F, F) - 3) - mu * (J - 1) + (local + mu) / 2 * (J - 1) ** 2


def barrier(F, mu, local):
    """eq. 14 with the alpha of the errata: mu = 4/3 mu_lame, lambda = lambda_lame + 5/6 mu_lame."""
    J, I_C, mu, lam = ufl.det(F), ufl.inner(F, F), 4 / 3 * mu, local + 5 / 6 * mu
    alpha = 1 + 3 / 4 * mu / lam
    volume = lam / 2 * ((J - alpha) ** 2 - (1 - alpha) ** 2)
    return mu / 2 * (I_C - 3) - mu / 2 * ufl.ln((I_C + 1) / 4) + volume


KEYWORDS = MATERIALS | {"hencky": {"name": "hencky", "nu": 0.45}}
ENERGIES = {
    "stable_neo_hookean": Volume(quadratic, stable),
    "stable_neo_hookean+barrier": Volume(quadratic, barrier),
    "neo_hookean": Volume(logarithmic),
    "fixed_corotational": Volume(quadratic),
    "hencky": Volume(logarithmic),
}
HOLD = [Hold("bottom"), Hold("right", ("x", "z"))]


def pairs(elements):
    """``element`` with each energy."""
    return pytest.mark.parametrize("element, name", [(e, n) for e in elements for n in ENERGIES])


def moduli(p):
    """(mu_lame, lambda_local, k) [Pa]: 1/lambda_local = 1/lambda + 1/(b mu)."""
    mu, lam = p.regions[0].material.lame
    b = 2 if p.saddle_point else 4
    local = 1 / (1 / lam + 1 / (b * mu))
    return mu, local, lam - local


def problem(body, element, name, **conditions):
    return create_problem(body, ELEMENTS[element], material(E=1.0, **KEYWORDS[name]), **conditions)


def set_state(p, field, push=0.0):
    """Set displacements to field((n, 3)) at this rank's nodes, pressures to waves of ``push``."""
    n = 3 * _dolfinx.num_nodes(p.V)[0]
    p.x.array[:n] = field(p.V.tabulate_dof_coordinates()[: n // 3]).ravel()
    if p.saddle_point:
        Q, _ = p.saddle_point.Q, p.saddle_point.pressure()
        X = Q.tabulate_dof_coordinates()[: _dolfinx.num_nodes(Q)[0]]
        p.x.array[n:] = push * (np.sin(X @ [3.0, 5, 2]) - 0.7)
    return p


def mixed_problem(comm, element, cells=3):
    """A cube with an unknown pressure; of Q1P0 and P2P0 one in each cell."""
    kind = ELEMENTS[element]
    kind = kind if kind.has_pressure else with_cell_pressures(kind)
    chosen = material("stable_neo_hookean", E=3.0, nu=0.49)
    return create_problem(cube(comm, kind.cell, cells, 0.05), kind, chosen, hold=[Hold("left")])


def set_inverted_state(p, inverted):
    """Set a state with inverted points, or nearly inverted ones if their energy is infinite."""
    size = 0.8
    set_state(p, wave(size), 0.8)
    while not inverted and p.measures(p.x)["min_J"] < 0.02:
        size *= 0.8
        set_state(p, wave(size), 0.8)
    assert np.isfinite(p.energy(p.x)) and (p.measures(p.x)["min_J"] < 0) == inverted
    return p
