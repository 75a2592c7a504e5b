"""Joints that drive parts, and rigid surfaces with a mass."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import converged, unit_cube, vector_space
from rigid_bodies import corner_program

import fem_snh
from fem_snh.errors import BadInput

mpi = pytest.mark.mpi

TIGHT = {"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-8}
HINGE = {"kind": "hinge", "axis": (0, 1, 0), "through": (0.75, 0.5, 0.4)}


def solved(comm, parts):
    problem = corner_program(comm, parts, petsc_options=TIGHT)
    problem.solve()
    assert converged(problem)
    return problem


@pytest.mark.one_debian("ranks")
@mpi
def test_a_hinge_that_a_force_or_its_torque_turns_is_inverse_to_the_rotation(comm):
    """An elbow: a lever on a hinge, flexed by its joint, by a force, and by a prescribed angle."""
    driven = solved(comm, [{"tag": 2, "joint": HINGE | {"torque": 60.0}}])
    state = driven._problem.rigid_states(driven.x)["dx(2)"]
    assert state["moment"][1] == pytest.approx(60.0, rel=1e-8)
    angle = state["rotation"][1]
    assert angle > 0.02
    turn = {"axis": (0, 1, 0), "angle": angle, "through": HINGE["through"]}
    turned = solved(comm, [{"tag": 2, "rotate": turn, "about": HINGE["through"]}])
    reaction = turned._problem.rigid_states(turned.x)["dx(2)"]
    assert turned.u.x.array == pytest.approx(driven.u.x.array, abs=1e-8)
    assert reaction["moment"][1] == pytest.approx(60.0, rel=1e-7)
    forced = solved(comm, [{"tag": 2, "joint": HINGE, "torque": (0, 60.0, 0)}])
    assert forced.u.x.array == pytest.approx(driven.u.x.array, abs=1e-8)


@pytest.mark.one_debian("ranks")
@mpi
def test_a_driven_joint_between_parts_acts_on_both(comm):
    """It is a moment on one part and the opposite one on the other, at the hinge's axis."""
    base = {"tag": 2}
    joint = {"kind": "hinge", "axis": (0, 1, 0), "through": (0.4, 0.5, 0.8), "to": "dx(2)"}
    driven = solved(comm, [dict(base), {"tag": 3, "joint": joint | {"torque": 20.0}}])
    loads = [{**base, "torque": (0, -20.0, 0)}, {"tag": 3, "joint": joint, "torque": (0, 20.0, 0)}]
    pair = solved(comm, loads)
    assert np.abs(driven.u.x.array).max() > 1e-3
    assert driven.u.x.array == pytest.approx(pair.u.x.array, abs=1e-8)


def test_other_joints_have_no_torque():
    with pytest.raises(BadInput, match=r"torque = 1.0: expected no value, but for a hinge"):
        fem_snh.Rigid(ufl.dx, joint={"kind": "ball", "through": (0, 0, 0), "torque": 1.0})


@mpi
def test_surface_with_a_mass_falls_onto_a_spring(comm):
    """z = -(m g / k) (1 - cos(sqrt(k / m) t)), Newmark's error of second order."""
    domain = unit_cube(comm, 2)
    u = fem.Function(vector_space(domain))
    m = fem_snh.material("stable_neo_hookean", E=1e9, nu=0.3)
    mass, stiffness, duration, steps = 50.0, 2e3, 0.5, 20
    shell = fem_snh.Rigid(ufl.ds, name="shell", mass=mass, spring={"stiffness": stiffness})
    terms = [fem_snh.Gravity([0, 0, -9.81]), shell]  # the weight is of both all the same
    problem = fem_snh.DynamicProblem(
        u,
        {m: ufl.dx},
        {m: 1e-4},
        "newmark",
        duration=duration,
        terms=terms,
    )
    problem.start()
    for _ in range(steps):
        assert problem.step(duration / steps)
    rate = np.sqrt(stiffness / mass)
    exact = -mass * 9.81 / stiffness * (1 - np.cos(rate * duration))
    state = problem._problem.rigid_states(problem.x)["shell"]
    assert state["position"][2] - 0.5 == pytest.approx(exact, rel=2e-3)
    assert problem.dynamics.mass.total == pytest.approx(mass, rel=1e-4)


def test_a_mass_needs_time(comm):
    with pytest.raises(BadInput, match=r"rigid.mass = 1.0: expected no value, without \[time\]"):
        corner_program(comm, [{"tag": 2, "mass": 1.0}])
