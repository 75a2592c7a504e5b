"""Taylor-Hood elements in runs: solvers, nu = 1/2, pressure, what is refused."""

from math import pi

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Hold, create_problem, cube, dense, wave
from scipy.linalg import eigh
from solver_problems import SYMMETRIC
from volume_energies import TAYLOR_HOOD

from fem_snh.assembly.elements import ELEMENTS, with_cell_pressures
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material
from fem_snh.runs import run

mpi = pytest.mark.mpi
taylor_hood = pytest.mark.parametrize("element", TAYLOR_HOOD)


def turned(**overrides):
    """Half of the twist's first quarter turn."""
    settings = {"cells": 3, "angle": pi / 4, "steps": 1, "hessian": "adaptive", "progress": False}
    return run("twist", **settings | overrides)


def linear_per_newton(result):
    """Return the linear iterations per Newton iteration."""
    return sum(s["linear"] for s in result.steps) / sum(s["newton"] for s in result.steps)


@pytest.mark.one_debian
@mpi
@taylor_hood
@pytest.mark.parametrize("nu", [0.3, 0.4999, 0.5])
def test_the_default_and_a_direct_solver_reach_the_same_state(element, nu):
    tight = {"snes_scaled_tol": 1e-10}
    found = [turned(element=element, nu=nu, petsc=tight | more) for more in ({}, SYMMETRIC)]
    assert all(result.converged for result in found)
    energies = [result.steps[-1]["energy"] for result in found]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)
    if nu == 0.5:
        volumes = [result.steps[-1]["volume_ratio"] for result in found]
        assert volumes == pytest.approx([1, 1], abs=1e-9)


@pytest.mark.one_debian
@mpi
@taylor_hood
def test_linear_iterations_depend_neither_on_nu_nor_on_the_mesh(element):
    """Stretch in one load step: at most 8 a Newton iteration, at nu = 1/2 at most twice as many."""
    common = {"element": element, "steps": 1, "stretch": 1.2, "progress": False}
    nus, meshes = (0.3, 0.4999, 0.5), (4, 8)
    by_nu = [linear_per_newton(run("stretch", cells=4, nu=nu, **common)) for nu in nus]
    assert max(by_nu) <= 8 and by_nu[2] <= 2 * by_nu[0]
    by_mesh = [linear_per_newton(run("stretch", cells=n, nu=0.4999, **common)) for n in meshes]
    assert by_mesh[1] <= 1.25 * by_mesh[0]


def schur_eigenvalues(element, cells, nu):
    """The eigenvalues of the preconditioned Schur complement of a deformed cube."""
    body = cube(MPI.COMM_SELF, element.cell, cells, 0.05)
    made = material("stable_neo_hookean", E=1.0, nu=nu)
    p = create_problem(body, element, made, hold=[Hold("left")])
    n = 3 * len(p.coordinates)
    p.x.array[:n] = wave(0.1)(p.V.tabulate_dof_coordinates()).ravel()
    p.prescribe(p.x)
    p.jacobian(p.x, "clamp")
    p.saddle_point.update_schur_approximation(p.A)
    A = dense(p.A)
    H, B, C = A[:n, :n], A[n:, :n], -A[n:, n:]
    S = B @ np.linalg.solve(H, B.T) + C
    return eigh(S, -dense(p.saddle_point.schur_approximation), eigvals_only=True)


@pytest.mark.one_debian
@taylor_hood
@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_bounds_of_the_schur_complement(element, nu):
    """On two meshes."""
    for cells in (2, 3):
        values = schur_eigenvalues(ELEMENTS[element], cells, nu)
        assert 0.4 < values[0] and values[-1] < 3.5


@pytest.mark.one_debian
@pytest.mark.parametrize("element, meshes", [("Q1P0", (3, 6)), ("P2P0", (2, 3))])
@pytest.mark.parametrize("nu", [0.3, 0.4999])
def test_bounds_of_the_schur_complement_of_cell_pressures(element, meshes, nu):
    """Also for pressures that alternate from cell to cell, the more cells the less B^T p."""
    for cells in meshes:
        values = schur_eigenvalues(with_cell_pressures(ELEMENTS[element]), cells, nu)
        assert 0.15 < values[0] and values[-1] < 3


@pytest.mark.one_debian
@mpi
def test_minres_has_a_definite_preconditioner_and_the_same_solution():
    """Flexible GMRES with its triangular preconditioner needs at most half of the iterations."""
    tight = {"snes_scaled_tol": 1e-10}
    found = [
        turned(element="Q2Q1", nu=0.5, petsc=tight | more)
        for more in ({}, {"ksp_type": "minres"}, {"fieldsplit_u_pc_type": "hypre"})
    ]
    assert all(result.converged for result in found)
    energies = [result.steps[-1]["energy"] for result in found]
    assert energies == pytest.approx([energies[0]] * 3, rel=1e-9)
    assert linear_per_newton(found[0]) <= 0.5 * linear_per_newton(found[1])
    assert linear_per_newton(found[2]) < linear_per_newton(found[1])


@pytest.mark.parametrize("element", ["P1", "Q2", "P2P0", "Q1P0"])
def test_incompressible_material_needs_a_pressure(element):
    with pytest.raises(BadInput, match=r"nu = 0\.5.*P2P1, Q2Q1"):
        turned(element=element, nu=0.5)
