"""Frequencies of bodies with rigid parts: a mass on springs, a weight on a soft bar."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import unit_cube, vector_space
from running import solve

import fem_snh
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Modes, Rigid, Scene

mpi = pytest.mark.mpi

SIDES, DENSITY = np.array([1.0, 0.6, 0.3]), 1000.0


def modes_of_a_box(u, count, torque=0.0, **keys):
    """Return the modes of a rigid body on linear springs, which a torque about z turns."""
    m = fem_snh.material("stable_neo_hookean", E=1e6, nu=0.45)
    spring = {"stiffness": 5e4, "rotation": 300.0}
    box = fem_snh.Rigid(ufl.dx, name="box", spring=spring, torque=(0, 0, torque))
    problem = fem_snh.NonlinearProblem(u, {m: ufl.dx}, terms=[box], **keys)
    problem.solve()
    return problem.vibration_modes(count, DENSITY)


@pytest.mark.one_debian("ranks")
@mpi
def test_rigid_mass_on_springs(comm):
    """Three translations of sqrt(k / m), three rotations of sqrt(kappa / I)."""
    domain = unit_cube(comm, 2)
    domain.geometry.x[:] *= SIDES
    found = modes_of_a_box(fem.Function(vector_space(domain)), 6)
    mass = DENSITY * SIDES.prod()
    inertia = mass / 12 * ((SIDES**2).sum() - SIDES**2)
    squares = np.concatenate([np.full(3, 5e4 / mass), 300.0 / inertia])
    assert found.frequencies == pytest.approx(np.sort(np.sqrt(squares)) / (2 * np.pi), rel=1e-9)


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("torque", [0.0, 120.0])
def test_torque_in_a_plane_leaves_the_frequencies_of_linear_springs(comm, torque):
    """About the angle to which it turns a rigid rectangle, 0.4: its work is linear in the angle."""
    domain = mesh.create_unit_square(comm, 2, 2, mesh.CellType.quadrilateral)
    domain.geometry.x[:] *= SIDES * (1, 1, 0)
    u = fem.Function(vector_space(domain, components=2))
    modes = modes_of_a_box(u, 3, torque, kinematics="plane_strain")
    mass = DENSITY * SIDES[:2].prod()
    inertia = mass / 12 * (SIDES[:2] ** 2).sum()
    expected = np.sort(np.sqrt([5e4 / mass, 5e4 / mass, 300.0 / inertia])) / (2 * np.pi)
    assert modes.frequencies == pytest.approx(expected, rel=1e-9)
    assert modes.mass == pytest.approx(mass)
    turned = np.abs(u.x.array).max() > 0.1
    assert comm.allreduce(turned, op=MPI.MAX) == (torque > 0)


def bar(**keys):
    """Return a bar whose right half is rigid, or of a material that is much stiffer."""
    soft = MaterialChoice(name="stable_neo_hookean", E=1e5, nu=0.3, density=DENSITY)
    mesh = Geometry(source="bar", parameters={"length": 2.0, "interface": 1.0})
    return Scene(
        name="bar", mesh=mesh, cells=2, element="Q1", hold=[Hold(group="left")],
        modes=Modes(count=4), **{"material": soft} | keys,
    )  # fmt: skip


@mpi
def test_weight_on_a_bar_is_the_limit_of_a_stiff_one(comm):
    rigid = solve(bar(rigid=[Rigid(group="second")]), comm)
    soft = bar().materials[0]
    stiff = soft.model_copy(update={"E": 1e11, "group": "second"})
    limit = solve(bar(material=[soft, stiff]), comm)
    assert rigid.frequencies == pytest.approx(limit.frequencies, rel=1e-5)
