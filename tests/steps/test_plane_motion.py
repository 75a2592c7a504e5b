"""Motions and modes of two dimensions: exact recurrences, a layer of hexahedra, momenta, rods."""

from __future__ import annotations

from math import pi, sqrt

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from bodies import dense
from dolfinx import fem, mesh
from dolfinx_programs import vector_space
from mass_form import mass_matrix
from plane_programs import COMPONENTS, displacement, motion, prescribe, rectangle, zero

import fem_snh
from fem_snh.choices import INTEGRATORS
from fem_snh.problem import modes

mpi = pytest.mark.mpi
every = pytest.mark.parametrize("kinematics", COMPONENTS)


def advance(problem, steps):
    for row in problem.steps(steps):
        assert row["converged"], row["reason"]
    return row


def cantilever(components, integrator):
    """A beam, or a layer of hexahedra with u_z = 0, that swings under its weight, with damping."""
    if components == 2:
        domain = rectangle(MPI.COMM_SELF, "Q1", (0.0, 0.0), (2.0, 0.5), (6, 3))
    else:
        corners = [np.zeros(3), np.array([2.0, 0.5, 0.25])]
        domain = mesh.create_box(MPI.COMM_SELF, corners, [6, 3, 1], mesh.CellType.hexahedron)
    V = vector_space(domain, 1, components)
    u, held = fem.Function(V), fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0))
    bcs = [fem.dirichletbc(np.zeros(components), held, V)]
    if components == 3:
        bcs.append(fem.dirichletbc(0.0, every_dof(V.sub(2)), V.sub(2)))
    made = motion(
        u, "plane_strain" if components == 2 else None, integrator, bcs=bcs,
        terms=[fem_snh.Gravity([0, -0.02, 0], lambda load: 1.0)], damping=(0.05, 0.1),
        duration=12.0, petsc_options={"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-11},
    )  # fmt: skip
    made.start(lambda X: np.array([0.0, 0.1, 0.0])[:components] * X[:, :1])
    row = advance(made, 6)
    return V.tabulate_dof_coordinates(), u.x.array.reshape(-1, components), row


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_swinging_beam_is_the_layer(integrator):
    """Displacements, energies, dissipation and momenta: damping turns with the cells."""
    X, u, plane = cantilever(2, integrator)
    X3, u3, solid = cantilever(3, integrator)
    assert abs(u).max() > 0.08
    for x, displaced in zip(X3, u3, strict=True):
        nearest = abs(X[:, :2] - x[:2]).sum(axis=1).argmin()
        assert abs(u[nearest] - displaced[:2]).max() < 1e-9
    for name in ("kinetic", "elastic", "potential", "dissipated"):
        assert plane[name] * 0.25 == pytest.approx(solid[name], rel=1e-7, abs=1e-12)
    assert np.array(plane["momentum"]) * 0.25 == pytest.approx(solid["momentum"], abs=1e-9)
    moments = plane["angular_momentum"][2] * 0.25, solid["angular_momentum"][2]
    assert moments[0] == pytest.approx(moments[1], abs=1e-9)


@mpi
@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_spinning_ring(comm, mass):
    """Momentum along the axis, and about it, are kept; so is the energy; nothing is damped."""
    omega, low, high = 0.3, 1.0, 1.5
    domain = rectangle(comm, "Q1", (low, 0.0), (high, 0.5), (3, 3))
    u = displacement(domain, "Q1", "axisymmetric_torsion")
    spinning = motion(u, "axisymmetric_torsion", mass=mass, damping=(0.0, 0.02), duration=0.4)
    spinning.start(lambda X: X[:, :1] * [0, 0, -omega] + [0, 0.1, 0])
    before = spinning.energies()
    weight = 2.0 * pi * (high**2 - low**2) * 0.5
    if mass == "consistent":
        inertia = 2.0 * pi / 2 * (high**4 - low**4) * 0.5
        assert before["angular_momentum"][1] == pytest.approx(inertia * omega, rel=1e-12)
        kinetic = inertia * omega**2 / 2 + weight * 0.1**2 / 2
        assert before["kinetic"] == pytest.approx(kinetic, rel=1e-12)
    assert before["momentum"] == pytest.approx([0, 0.1 * weight, 0], rel=1e-12)
    after = advance(spinning, 8)
    turned = abs(u.x.array.reshape(-1, 3)[:, 2]).max(initial=0)
    assert comm.allreduce(turned, op=MPI.MAX) > 0.1
    for name in ("momentum", "angular_momentum"):
        assert after[name] == pytest.approx(before[name], rel=1e-4, abs=1e-10)
    assert after["kinetic"] + after["elastic"] == pytest.approx(before["kinetic"], rel=1e-4)
    # C v of a rigid rotation is zero but for the centrifugal strain.
    assert 0 <= after["dissipated"] < 1e-4 * before["kinetic"]


@pytest.mark.parametrize("element", ["Q1", "P2", "Q2"])
@every
def test_mass_matrices_are_those_of_ufl(element, kinematics):
    """Of inertia and of modes, on distorted cells from the axis outwards."""
    domain = rectangle(MPI.COMM_SELF, element, (0.0, 0.0), (1.0, 1.0), (2, 2))
    domain.geometry.x[:, 1] += 0.2 * domain.geometry.x[:, 0] * domain.geometry.x[:, 1]
    u = displacement(domain, element, kinematics)
    made = motion(u, kinematics, duration=1.0)
    V, size = u.function_space, COMPONENTS[kinematics]
    revolved = kinematics != "plane_strain"
    expected = dense(mass_matrix(V, 2.0, revolved))
    found = made.dynamics.mass.matrix.toarray()
    for i in range(size):
        assert abs(found - expected[i::size, i::size]).max() < 1e-14 * abs(expected).max() * 10
    total = pi if revolved else 1.0
    assert found.sum() == pytest.approx(2 * total * (1 + 0.2 * (2 / 3 if revolved else 1 / 2)))


@pytest.mark.one_debian
@pytest.mark.parametrize("kinematics, kind", [
    ("plane_strain", "compression"), ("axisymmetric", "rod"), ("axisymmetric_torsion", "torsion"),
])  # fmt: skip
def test_lowest_modes_of_a_rod(kinematics, kind):
    """c / (4 L) (2 k - 1): compression, a rod at nu = 0, and torsion."""
    length, density, E = 1.0, 2.0, 1.0
    nu = 0.3 if kind == "compression" else 0.0
    material = fem_snh.material("stable_neo_hookean", E=E, nu=nu)
    mu, lam = material.lame
    domain = rectangle(MPI.COMM_SELF, "Q2", (0.0, 0.0), (0.01, length), (1, 8))
    u = displacement(domain, "Q2", kinematics)
    V = u.function_space
    bcs = prescribe(V, 1, 0.0, zero)
    kept = {"compression": [1], "rod": [0, 1], "torsion": [2]}[kind]
    for component in set(range(COMPONENTS[kinematics])) - set(kept):
        bcs.append(fem.dirichletbc(0.0, every_dof(V.sub(component)), V.sub(component)))
    made = fem_snh.NonlinearProblem(u, {material: ufl.dx}, bcs=bcs, kinematics=kinematics)
    speed = sqrt({"compression": 2 * mu + lam, "rod": E, "torsion": mu}[kind] / density)
    found = modes.lowest(made._problem, density, 3)
    expected = [speed / (4 * length) * k for k in (1, 3, 5)]
    assert found.frequencies == pytest.approx(expected, rel=1e-3)
    volume = 0.01 if kind == "compression" else pi * 0.01**2
    assert found.mass == pytest.approx(density * volume, rel=1e-12)


def every_dof(V):
    """The dofs of one component."""
    topology = V.mesh.topology
    topology.create_connectivity(topology.dim, topology.dim)
    cells = np.arange(topology.index_map(topology.dim).size_local, dtype=np.int32)
    return fem.locate_dofs_topological(V, topology.dim, cells)
