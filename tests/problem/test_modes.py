"""Eigenfrequencies: beams, a dense solver, rigid modes, scaling, unstable states, ranks, files."""

from __future__ import annotations

from itertools import pairwise

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from bodies import (
    MINIMISING,
    Condition,
    Hold,
    constrained,
    create_problem,
    cube,
    dense,
    problem,
    set_values,
    wave,
)
from dolfinx import fem
from dolfinx.mesh import CellType, create_box
from dolfinx_programs import vector_space
from mass_form import mass_matrix
from running import solve
from scipy.linalg import eigh
from scipy.optimize import brentq

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.mesh.mesh import generate
from fem_snh.problem import modes
from fem_snh.scenes import Geometry

mpi = pytest.mark.mpi


def hertz(values):
    """Frequencies of eigenvalues omega^2, negative where these are."""
    return np.sign(values) * np.sqrt(abs(values)) / (2 * np.pi)


def timoshenko(ratio, nu, count):
    """omega L^2 sqrt(rho A/(E I)) of a cantilever of thickness 1 and length ``ratio``.

    E I w'' = ..., with rotary inertia r^2 = I/(A L^2) and shear s^2 = E I/(k G A L^2), k = 5/6:
    Huang 1961's frequency equation, below the cut-off.
    """
    r2 = 1 / 12 / ratio**2
    s2 = r2 * 2 * (1 + nu) * 6 / 5

    def equation(b):
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        al, be = np.sqrt((-(r2 + s2) + root) / 2), np.sqrt((r2 + s2 + root) / 2)
        cosines, sines = np.cosh(b * al) * np.cos(b * be), np.sinh(b * al) * np.sin(b * be)
        shear = b * (r2 + s2) / np.sqrt(1 - b**2 * r2 * s2)
        return 2 + (b**2 * (r2 - s2) ** 2 + 2) * cosines - shear * sines

    grid = np.linspace(0.5, 80, 2000)
    ends = [(a, b) for a, b in pairwise(grid) if equation(a) * equation(b) < 0]
    return np.array([brentq(equation, *pair) for pair in ends[:count]])


# --- oracles -------------------------------------------------------------------------------------


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", MINIMISING)
@pytest.mark.parametrize("strained", [False, True])
def test_against_a_dense_solver(comm, element, strained):
    """A tiny problem at rest and in a deformed state, which may be unstable."""
    body = cube(comm, ELEMENTS[element].cell, 1 if element[1] == "2" else 2, 0.03)
    p = problem(body, element, E=3.0, hold=[Hold("left"), Hold("front", ("y",))])
    if strained:
        set_values(p, wave(0.02))
        p.prescribe(p.x)
    found = modes.lowest(p, 2.0, 8)
    p.jacobian(p.x, "exact")
    K, M = dense(p.A), dense(mass_matrix(p.V, 2.0))
    free = np.concatenate(comm.allgather(~constrained(p)))
    K, M = K[free][:, free], M[free][:, free]
    expected = hertz(eigh((K + K.T) / 2, M, eigvals_only=True)[:8])
    assert found.frequencies == pytest.approx(expected, rel=1e-9)
    assert max(found.residuals) <= 1e-9
    pencil = modes.Eigenproblem(p, 2.0, "")
    ordered = eigh((K + K.T) / 2, M, eigvals_only=True)
    for k in (0, 3, len(ordered) - 1):
        bound = ordered[k] - 1e-3 * abs(ordered[k])
        assert pencil._count_below(bound) == (ordered < bound).sum()


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q2", "P2"])
@pytest.mark.parametrize("nu, bound", [(0.0, 1e-3), (0.3, 6e-3)])
def test_a_slender_beam(comm, element, nu, bound):
    """A bar of 1 x 1 x 20 with one end constrained bends as Timoshenko's beam, to 0.1 %.

    With nu = 0.3 to 0.6 %: its section cannot shrink where it is constrained.
    """
    length, E, density = 20.0, 5.0, 3.0
    # The coarsest cylinder has a square section.
    body = generate(comm, "cylinder", ELEMENTS[element].cell, cells=3, radius=0.5**0.5, length=20)
    name = fem_snh.material("neo_hookean", E=E, nu=nu)
    problem = create_problem(body, ELEMENTS[element], name, hold=[Hold("left")])
    found = modes.lowest(problem, density, 4)
    unit = np.sqrt(E / 12 / density) / length**2 / (2 * np.pi)
    expected = np.repeat(timoshenko(length, nu, 2), 2) * unit
    assert found.frequencies == pytest.approx(expected, rel=bound)
    euler_bernoulli = 1.8751040687**2 * unit
    assert found.frequencies[:2] == pytest.approx([euler_bernoulli] * 2, rel=5e-3)
    for shape in found.shapes:
        assert shape.vector.norm() > 0 and not shape.vector.array_r[constrained(problem)].any()


# --- free bodies, multiple eigenvalues -----------------------------------------------------------


@mpi
@pytest.mark.parametrize("length", [200.0, 1000.0])
def test_a_free_slender_bar(comm, length):
    """Its squares of frequencies are 1e-6 to 1e-9 of E / (density V^(2/3)): pairs and their count.

    With a shift of 1e-2 of that SLEPc needed minutes, and the bound of the count was a shift off.
    """
    low, high = np.zeros(3), np.array([length, 1.0, 1.0])
    domain = create_box(comm, [low, high], [40, 1, 1], CellType.hexahedron)
    u = fem.Function(vector_space(domain, 2))
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
    p = fem_snh.NonlinearProblem(u, {material: ufl.dx}, element="Q2")._problem
    pencil = modes.Eigenproblem(p, 1.0, "")
    values, _ = pencil.lowest(10)
    bending = np.repeat([4.7300407449, 7.8532046241], 2) ** 2 / (12**0.5 * length**2)
    assert abs(values[:6]).max() <= 1e-3 * bending[0] ** 2
    assert np.sqrt(values[6:]) == pytest.approx(bending, rel=3e-3)
    assert pencil._size_of(10) == pytest.approx(values[9], rel=10)  # not 1e3 to 1e6 times as large
    assert pencil._count_below(values[9] / 2) == 8


@mpi
def test_an_unstable_state_has_negative_frequencies(comm):
    """Pressed to 0.4 of its length between smooth plates, a slender bar wants to buckle."""

    def press(X, load):
        return -0.4 * load * X * [1, 0, 0]

    rollers = [Hold("left"), Condition("right", press)]
    body = cube(comm, "hexahedron", 4)
    _dolfinx.geometry_x(body.domain)[:, 0] *= 6
    p = problem(body, "Q1", hold=rollers[:1], move=rollers[1:])
    p.set_load(1.0)
    set_values(p, lambda X: press(X, 1.0))
    found = modes.lowest(p, 1.0, 6)
    p.jacobian(p.x, "exact")
    K, M = dense(p.A), dense(mass_matrix(p.V, 1.0))
    free = np.concatenate(comm.allgather(~constrained(p)))
    expected = hertz(eigh(K[free][:, free], M[free][:, free], eigvals_only=True)[:6])
    assert expected[0] < 0
    assert found.frequencies == pytest.approx(expected, rel=1e-7)


# --- scaling, materials, ranks -------------------------------------------------------------------


@pytest.mark.one_debian
@mpi
def test_frequencies_scale_as_the_square_root_of_E_over_density_over_length(comm):
    found = []
    for E, density, size in ((1.0, 1.0, 1.0), (200e9, 7800.0, 1e-3), (1e3, 1e3, 50.0)):
        p = problem(cube(comm, "hexahedron", 2, size=size), "Q1", E=E, hold=[Hold("left")])
        unit = np.sqrt(E / density) / size
        found.append(np.array(modes.lowest(p, density, 5).frequencies) / unit)
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[2] == pytest.approx(found[0], rel=1e-9)


@mpi
@pytest.mark.parametrize("free", [False, True])
def test_any_number_of_ranks_gives_the_same_frequencies(comm, free):
    setup = {"cells": 3, "count": 10, "aspect": 1.5, "element": "P2"}
    setup |= {"hold": []} if free else {}
    alone, together = (solve("modes", ranks, **setup) for ranks in (MPI.COMM_SELF, comm))
    one, other = alone.frequencies, together.frequencies
    assert other == pytest.approx(one, rel=1e-9, abs=1e-6 * one[-1])
    start = 6 if free else 0
    assert other[start:] == pytest.approx(one[start:], rel=1e-9)


def test_eigenvalues_that_a_search_misses_are_searched_again():
    """Five of six are found in three restarts."""
    setup = {"mesh": Geometry(source="bar", parameters={"length": 2.0}), "cells": 2, "count": 6}
    petsc = {"modes_eps_max_it": 3, "modes_eps_ncv": 12}
    one, several = (solve("modes", petsc=o, **setup).frequencies for o in ({}, petsc))
    assert several == pytest.approx(one, rel=1e-9)


@pytest.mark.one_debian("ranks")
@mpi
def test_modes_of_a_loaded_state_come_after_the_load_steps(comm):
    """A pulled bar is stiffer across: its lowest frequency rises, as a string's."""
    setup = {"cells": 3, "steps": 1, "mesh": Geometry(source="cube"), "modes": {"count": 2}}
    found = [solve("pull", stretch=s, **setup) for s in (1.0 + 1e-9, 1.5)]
    assert found[1].frequencies[0] != pytest.approx(found[0].frequencies[0], rel=1e-2)
    assert all(step["reactions"] for step in found[1].steps)
