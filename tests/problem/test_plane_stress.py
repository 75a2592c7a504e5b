"""Plane stress: exact states of a sheet, its tangent, its filters, and a thin sheet in 3D."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from derivatives import check_derivatives
from dolfinx import fem, mesh
from dolfinx_programs import vector_space
from plane_programs import displacement, prescribe, rectangle, sides, solve, zero
from scipy.optimize import brentq, minimize_scalar
from test_plane_problems import check_filters

import fem_snh

ELEMENTS = ("P1", "P2", "Q1", "Q2")
KIND = {"kinematics": "plane_stress"}
SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.45)


def square(element, material, move=0):
    """The problem of a square, not solved, whose nodes are moved."""
    domain = rectangle(MPI.COMM_SELF, element, (0.0, 0.0), (1.0, 1.0), (2, 2))
    domain.geometry.x[:, :2] += move
    u = displacement(domain, element, "plane_strain")
    return fem_snh.NonlinearProblem(u, {material: ufl.dx}, element=element, **KIND)._problem


def affine(material, F):
    """The problem of a square with the displacement (F - I) x."""
    made = square("Q1", material)
    made.x.array[:] = (made.coordinates[:, :2] @ (np.array(F) - np.eye(2)).T).ravel()
    return made


@pytest.mark.one_debian
@pytest.mark.parametrize("name", ["stable_neo_hookean", "neo_hookean_simo", "corotational"])
@pytest.mark.parametrize("F", [
    [[1.3, 0], [0, 1.3]], [[1.5, 0.4], [0.1, 0.7]], [[0.6, 0], [0, 0.9]],
    [[1 + 1e-7, 3e-8], [0, 1 - 2e-8]], [[1, 0], [0, 1]], [[1, 0.6], [0, 1]],
])  # fmt: skip
def test_energy_and_thickness_are_those_of_the_minimum(name, F):
    """The energy of the sheet is the smallest one over F33, from 1e-7 to large strains."""
    material = fem_snh.material(name, E=1.0, nu=0.4)
    made = affine(material, F)
    full = np.eye(3)
    full[:2, :2] = F

    def P33(s):
        full[2, 2] = s
        return material.pk1(full)[2, 2]

    s = brentq(P33, 0.02, 20, xtol=1e-15, rtol=1e-14)
    full[2, 2] = s
    assert made.energy(made.x) == pytest.approx(material.energy(full), rel=1e-7, abs=1e-15)
    J = made.measures(made.x)["volume_ratio"]
    assert J - 1 == pytest.approx(np.linalg.det(full) - 1, rel=1e-8, abs=1e-14)


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("element", ELEMENTS)
def test_uniaxial_stretch_of_a_sheet(comm, element):
    """The closed form of eq. 13 of Smith et al. 2018: both lateral stretches are sqrt(J/s)."""
    E, nu, s = 1.0, 0.45, 1.8
    material = fem_snh.material("stable_neo_hookean", E=E, nu=nu)
    mu, lam = material.lame[0], sum(material.lame)
    J = 1 + mu / lam * (1 - 1 / s)
    domain = rectangle(comm, element, (0.0, 0.0), (1.0, 0.5), (3, 2))
    u = displacement(domain, element, "plane_strain")
    V = u.function_space
    bcs = prescribe(V, 0, 0.0, zero, [0]) + prescribe(V, 1, 0.0, zero, [1])
    bcs += prescribe(V, 0, 1.0, lambda x: np.array([[s - 1], [0.0]]), [0])
    made = solve(u, material, bcs, element=element, **KIND)
    x, values = V.tabulate_dof_coordinates(), u.x.array.reshape(-1, 2)
    assert abs(values[:, 1] - x[:, 1] * (np.sqrt(J / s) - 1)).max(initial=0) < 1e-9
    force = made._problem.x.duplicate()
    made._problem.gradient(made.x, force)
    nodes = sides(V, 0, 1.0)
    owned = V.dofmap.index_map.size_local
    total = comm.allreduce(force.array[2 * nodes[nodes < owned]].sum())
    assert total == pytest.approx(0.5 * mu * (s - J / s**2), rel=1e-9)
    assert made._problem.measures(made.x)["volume_ratio"] == pytest.approx(J, rel=1e-10)


def scattered(element, material=SNH, size=0.03):
    rng = np.random.default_rng(0)
    made = square(element, material, rng.uniform(-0.05, 0.05, (9, 2)))
    made.x.array[:] = rng.uniform(-size, size, made.x.getLocalSize())
    return made


@pytest.mark.one_debian
@pytest.mark.parametrize(
    "element, name",
    [(element, "stable_neo_hookean") for element in ELEMENTS]
    + [("Q2", name) for name in ("neo_hookean_simo", "stvk", "corotational")],
)
def test_residual_and_hessian_are_derivatives(element, name):
    """Central differences of the energy and of the residual: the condensed tangent is exact."""
    made = scattered(element, fem_snh.material(name, E=1.0, nu=0.4))
    check_derivatives(made, range(0, made.x.getLocalSize(), 5), 1e-6, 1e-8, 1e-8)


@pytest.mark.parametrize("element", ELEMENTS)
def test_filtered_hessian_is_positive_semidefinite(element):
    """The Schur complement of a semidefinite matrix is semidefinite; the exact one is neither."""
    check_filters(scattered(element, size=0.6))


def test_an_inverted_cell_has_the_energy_of_its_thinnest_state():
    """Turned over in its plane there is no root in F33 > 0; the energy is the bound's minimum."""
    made = affine(SNH, np.diag([-0.8, 1.1]))

    def energy(s):
        return float(SNH.energy(np.diag([-0.8, 1.1, s])))

    least = minimize_scalar(energy, bounds=(1e-3, 1e3), method="bounded")
    assert least.x < 2e-3 and energy(1e-3) <= least.fun
    assert made.energy(made.x) == pytest.approx(energy(1e-3), rel=1e-12)


def sheet(thick):
    """A sheet that is sheared and stretched at one side: in the plane, or a layer in 3D."""
    if thick is None:
        domain = rectangle(MPI.COMM_SELF, "Q2", (0.0, 0.0), (1.0, 1.0), (4, 4))
    else:
        corners, cells = [np.zeros(3), np.array([1.0, 1.0, thick])], [4, 4, 1]
        domain = mesh.create_box(MPI.COMM_SELF, corners, cells, mesh.CellType.hexahedron)
    dim = domain.topology.dim
    V = vector_space(domain, 2, dim)
    u = fem.Function(V)

    def nodes(space, axis, at):
        facets = mesh.locate_entities_boundary(domain, dim - 1, lambda x: np.isclose(x[axis], at))
        return fem.locate_dofs_topological(space, dim - 1, facets)

    # The thickness is free to change everywhere: the sides prescribe the plane's components alone.
    bcs = []
    for component, value in ((0, 0.4), (1, 0.3)):
        bcs.append(fem.dirichletbc(0.0, nodes(V.sub(component), 0, 0.0), V.sub(component)))
        bcs.append(fem.dirichletbc(value, nodes(V.sub(component), 0, 1.0), V.sub(component)))
    if dim == 3:
        bcs.append(fem.dirichletbc(0.0, nodes(V.sub(2), 2, 0.0), V.sub(2)))
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.4)
    made = solve(u, material, bcs, element="Q2", **(KIND if dim == 2 else {}))
    energy = made._problem.energy(made.x) / (thick or 1.0)
    return V.tabulate_dof_coordinates(), u.x.array.reshape(-1, dim), energy


def test_a_thin_sheet_in_three_dimensions_tends_to_it():
    """The difference of the energies decreases with the thickness, below a part in 1000."""
    X, u, energy = sheet(None)
    errors = []
    for thick in (0.2, 0.05):
        X3, u3, energy3 = sheet(thick)
        errors.append(abs(energy3 / energy - 1))
    assert errors[1] < errors[0] / 2 and errors[1] < 2e-3
    middle = [abs(x[:, :2] - 0.5).sum(axis=1).argmin() for x in (X, X3)]
    np.testing.assert_allclose(u3[middle[1], :2], u[middle[0]], atol=2e-3)
