"""Eigenfrequencies: beams, a dense solver, rigid modes, scaling, unstable states, ranks, files."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from beam_theory import timoshenko
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
from scipy.linalg import eigh

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.mesh.mesh import generate
from fem_snh.problem import modes

mpi = pytest.mark.mpi


def hertz(values):
    """Frequencies of eigenvalues omega^2, negative where these are."""
    return np.sign(values) * np.sqrt(abs(values)) / (2 * np.pi)


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
