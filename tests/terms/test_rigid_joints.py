"""Joints that drive parts, and rigid surfaces with a mass."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx_programs import converged
from rigid_bodies import corner_program

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
