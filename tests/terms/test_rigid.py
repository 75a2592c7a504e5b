"""Rigid parts: exact solutions, derivatives, joints, and loads that are the inverse of motions."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx_programs import converged
from rigid_bodies import (
    HEIGHT,
    INNER,
    MU,
    OUTER,
    bushing,
    bushing_mesh,
    corner_program,
    first_derivative,
    move_away,
    wave,
)
from running import solve

from fem_snh.scenes import Scene

mpi = pytest.mark.mpi

TIGHT = {"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-8}


HINGE = {"kind": "hinge", "axis": (0, 1, 0), "through": (0.75, 0.5, 0.4)}


def solved(comm, parts):
    problem = corner_program(comm, parts, petsc_options=TIGHT)
    problem.solve()
    assert converged(problem)
    return problem


@mpi
def test_the_whole_hessian_is_the_derivative_of_forces_without_an_energy(comm):
    """Of a pressure with a free edge, a force that follows its part, and a moment."""
    loads = {"force": (30.0, 20.0, -50.0), "torque": (4.0, -6.0, 5.0)}
    parts = [{"tag": 2, "follower": True, **loads}, {"tag": 3, **loads}]
    problem = corner_program(comm, parts, pressure=500.0)._problem
    problem.set_load(1.0)
    move_away(problem)
    x, end, Hd = (problem.x, *(problem.x.duplicate() for _ in range(2)))
    d = wave(problem, 5.0, 0.1)

    def forces(s):
        f = x.duplicate()
        problem.retraction(x, d, s, end)
        problem.residual(end, f)
        return f

    wanted = first_derivative(forces, 0.0, 1e-3)
    problem.jacobian(x, "exact", whole=True)
    assert problem.asymmetric
    problem.operator.mult(d, Hd)
    Hd.array[problem.constrained_dofs] = wanted.array[problem.constrained_dofs] = 0.0
    assert (Hd - wanted).norm() <= 1e-8 * wanted.norm()


@pytest.mark.one_debian
def test_filtered_hessian_is_positive_semidefinite_and_keeps_its_blocks(comm):
    problem = corner_program(comm, [{"tag": 2, "rotate": {"axis": (0, 1, 0), "angle": 0.9}}])
    problem.solve()
    loaded = corner_program(comm, [{"tag": 2}])._problem
    problem._problem.x.copy(loaded.x)
    for filter in ("exact", "clamp", "abs"):
        loaded.jacobian(loaded.x, filter)
        indptr, indices, values = loaded.A.getValuesCSR()
        dense = np.zeros((loaded.dofs, loaded.dofs))
        dense[np.repeat(np.arange(loaded.dofs), np.diff(indptr)), indices] = values
        assert abs(dense - dense.T).max() <= 1e-9 * abs(dense).max()
        lowest = np.linalg.eigvalsh(dense)[0]
        assert lowest < 0 if filter == "exact" else lowest > 0
    # Entries of the part beside its six unknowns are those of constrained dofs.
    assert len(loaded.constrained_dofs) == 3 * (25 + 3 * 3 * 5) - 6


@pytest.mark.one_debian
@mpi
def test_forces_and_motion_of_a_part_are_inverse_to_each_other(comm):
    turn = {"axis": (0, 1, 0.3), "angle": 0.3, "through": (0.75, 0.5, 0.75)}
    motion = {"translate": (0.05, 0.02, 0.1), "rotate": turn}
    moved = solved(comm, [{"tag": 2, **motion}])
    state = moved._problem.rigid_states(moved.x)["dx(2)"]
    axis = np.array([0, 1, 0.3]) / np.hypot(1, 0.3)
    assert state["rotation"] == pytest.approx(0.3 * axis, abs=1e-13)
    loaded = solved(comm, [{"tag": 2, "force": state["force"], "torque": state["moment"]}])
    assert loaded.u.x.array == pytest.approx(moved.u.x.array, abs=1e-8)


@pytest.mark.one_debian
@mpi
def test_prescribed_motion_of_a_face_is_that_of_move(comm):
    """A turn of 2 rad about an axis beside the body, in four steps."""
    keys = {
        "name": "a", "mesh": {"source": "cube"}, "cells": 3, "element": "Q1", "steps": 4,
        "material": {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.4},
        "hold": [{"group": "bottom"}], "reactions": ["top"], "petsc": TIGHT,
    }  # fmt: skip
    turn = {"axis": (0, 0, 1), "angle": 2.0, "through": (1, 1, 0)}
    motion = {"group": "top", "translate": (0.1, 0, 0.2), "rotate": turn}
    moved, rigid = (solve(Scene(**{table: [motion]}, **keys), comm) for table in ("move", "rigid"))
    assert moved.converged and rigid.converged
    a, b = (r.record["steps"][-1] for r in (moved, rigid))
    assert b["energy"] == pytest.approx(a["energy"], rel=1e-9)
    assert b["max_u"] == pytest.approx(a["max_u"], rel=1e-9)
    assert b["rigid"]["top"]["force"] == pytest.approx(a["reactions"]["top"], abs=1e-8)


@pytest.mark.one_debian
@mpi
def test_torque_on_a_sleeve_turns_it_as_the_closed_form_says(comm, folder):
    r"""Azimuthal shear of a neo-Hookean ring: :math:`\varphi = T / (4 \pi \mu h) (a^-2 - b^-2)`.

    It is exact for an incompressible material at any angle (Ogden 1984, section 5.2.2), and in the
    mean for a finite element solution, whose chords of the circles are 1 % inside.
    """
    angle = 0.3
    torque = 4 * np.pi * MU * HEIGHT * angle / (INNER**-2 - OUTER**-2)
    mesh_file = bushing_mesh(comm, folder)
    result = solve(bushing(mesh_file, {"torque": (0, 0, torque)}), comm)
    state = result.record["steps"][-1]["rigid"]["sleeve"]
    assert result.converged
    assert state["rotation"] == pytest.approx([0, 0, angle], rel=0.03, abs=1e-6)
    assert state["moment"] == pytest.approx([0, 0, torque], rel=1e-8, abs=1e-8 * torque)
    back = solve(bushing(mesh_file, {"rotate": {"axis": (0, 0, 1), "angle": state["rotation"][2]}}))
    moment = back.record["steps"][-1]["rigid"]["sleeve"]["moment"]
    assert moment[2] == pytest.approx(torque, rel=1e-8)


@pytest.mark.one_debian
@mpi
def test_rigid_body_in_contact_is_a_moved_surface_and_its_force(comm):
    """A block that is pressed onto another: moved, rigid and moved, rigid and loaded."""
    mesh = {"source": "two_blocks", "parameters": {"gap": 0.1, "upper_width": 0.6}}
    keys = {
        "name": "blocks", "mesh": mesh, "cells": 2, "element": "Q1", "steps": 2,
        "material": {"name": "stable_neo_hookean", "E": 1e4, "nu": 0.3},
        "hold": [{"group": "bottom"}], "contact": [{"groups": ("lower_top", "upper_bottom")}],
        "petsc": TIGHT,
    }  # fmt: skip
    down = {"translate": (0, 0, -0.3)}
    moved = solve(Scene(move=[{"group": "upper_surface"} | down], **keys), comm)
    rigid = solve(Scene(rigid=[{"group": "upper"} | down], **keys), comm)
    force = rigid.steps[-1]["rigid"]["upper"]["force"]
    other = moved.steps[-1]["contacts"]["lower_top/upper_bottom"]["force"]
    assert force == pytest.approx(other, abs=1e-6) and force[2] < -1000
    held = {"translate": (0, 0, 0), "free": ("z",), "spring": {"stiffness": 3000.0}}
    load = {"group": "upper", "force": (0, 0, force[2] - 3000 * 0.3)} | held
    pressed = solve(Scene(rigid=[load], **keys), comm)
    position = pressed.steps[-1]["rigid"]["upper"]["position"]
    assert position == pytest.approx(rigid.steps[-1]["rigid"]["upper"]["position"], abs=1e-8)


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
    joint = {"kind": "hinge", "axis": (0, 1, 0), "through": (0.4, 0.5, 0.8), "to": "dx(2)"}
    driven = solved(comm, [{"tag": 2}, {"tag": 3, "joint": joint | {"torque": 20.0}}])
    loads = {"tag": 2, "torque": (0, -20.0, 0)}, {"tag": 3, "joint": joint, "torque": (0, 20.0, 0)}
    pair = solved(comm, loads)
    assert np.abs(driven.u.x.array).max() > 1e-3
    assert driven.u.x.array == pytest.approx(pair.u.x.array, abs=1e-8)
