"""Rigid motions that nothing constrains: they are named before the first step."""

from __future__ import annotations

from functools import partial

from mpi4py import MPI

import pytest
import ufl
from dolfinx_programs import Bar, unit_cube
from running import solve

import fem_snh
from fem_snh.errors import BadInput
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Rigid, Scene, Spring, Traction

mpi = pytest.mark.mpi


def block(source="cube", parameters=None, **keys):
    mesh = Geometry(source=source, parameters=parameters or {})
    material = MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3)
    return Scene(name="block", mesh=mesh, cells=2, element="Q1", material=material, **keys)


def supports(comm, scene):
    """Return the text of the note on supports; empty without one."""
    notes = solve(scene, comm).record.get("notes", [])
    return next((note["text"] for note in notes if note["kind"] == "supports"), "")


def roller(group, axis):
    return Hold(group=group, components=(axis,))


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize(
    "hold, free",
    [
        ([Hold(group="bottom")], ""),
        ([roller("left", "x"), roller("front", "y"), roller("bottom", "z")], ""),
        ([roller("left", "x"), roller("front", "y")], "the body: the translation along z;"),
        (
            [roller("bottom", "z")],
            "the body: the translation along y, the translation along x, the rotation about z;",
        ),
    ],
    ids=["clamped", "rollers", "z", "plane"],
)
def test_motions_that_are_left_to_rollers(comm, hold, free):
    text = supports(comm, block(hold=hold))
    assert text.startswith(f"nothing constrains {free}") if free else text == ""


@pytest.mark.one_debian("ranks")
@mpi
def test_a_net_force_along_a_free_motion_is_an_error(comm):
    hold = [roller("left", "x"), roller("front", "y")]
    across = Traction(group="right", vector=(0.1, 0, 0))
    assert "translation along z" in supports(comm, block(hold=hold, traction=[across]))
    along = Traction(group="top", vector=(0, 0, 0.1))
    with pytest.raises(BadInput, match="the translation along z, along which loads act"):
        solve(block(hold=hold, traction=[along]), comm)
    # Two forces that balance each other are no net force; a spring constrains it.
    other = Traction(group="bottom", vector=(0, 0, -0.1))
    assert "along z" in supports(comm, block(hold=hold, traction=[along, other]))
    bed = Spring(group="bottom", stiffness=(0, 0, 1.0))
    assert supports(comm, block(hold=hold, traction=[along], spring=[bed])) == ""


@mpi
def test_rigid_parts_and_joints_constrain(comm):
    two = partial(block, "two_blocks", {"gap": 0.5}, hold=[Hold(group="bottom")])
    hinge = {"kind": "hinge", "axis": (0, 1, 0), "through": (0, 0.5, 1.25)}
    lid = Rigid(group="upper_bottom", joint=hinge)
    text = supports(comm, two(rigid=[lid]))
    assert text.startswith("nothing constrains the rotation about y of part ")
    turned = Rigid(group="upper_bottom", joint=hinge, torque=(0, 1, 0))
    with pytest.raises(BadInput, match=r"rotation about y.*loads act"):
        solve(two(rigid=[turned]), comm)
    sprung = Rigid(group="upper_bottom", joint=hinge, spring={"rotation": 1.0})
    assert supports(comm, two(rigid=[sprung])) == ""
    ball = hinge | {"kind": "ball", "axis": None, "to": "base"}
    carried = Rigid(group="upper_bottom", joint=ball)
    base = Rigid(group="lower_top", name="base")
    text = supports(comm, two(rigid=[base, carried]))
    assert text.count("the rotation about") == 3 and "translation" not in text


# --- two dimensions ------------------------------------------------------------------------------


flat = partial(block, "cook")


@pytest.mark.one_debian
@mpi
def test_a_plane_has_three_motions(comm):
    text = supports(comm, flat(kinematics="plane_strain"))
    assert text.startswith("nothing constrains the body: ") and text.count("the translation") == 2
    assert "the rotation about z" in text
    held = [roller("left", "x"), Hold(group="left", components=("y",))]
    assert supports(comm, flat(kinematics="plane_stress", hold=held)) == ""
    # The left side slides along y.
    keys = {"kinematics": "plane_strain", "hold": [roller("left", "x")]}
    keys["traction"] = [Traction(group="right", vector=(0, 1e-3, 0))]
    with pytest.raises(BadInput, match="the body: the translation along y, along which loads act"):
        solve(flat(**keys), comm)


# --- programs ------------------------------------------------------------------------------------

SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)


def program(comm, terms, make=fem_snh.NonlinearProblem):
    """Return the problem of a cube with rollers on the sides x = 0 and y = 0."""
    bar = Bar(unit_cube(comm, 2))
    return make(bar.u, {SNH: ufl.dx}, bcs=bar.bcs[:2], terms=[term(bar.u) for term in terms])


def push(u):
    """A dead load along z."""
    return -1e-3 * u[2] * ufl.ds


@mpi
def test_what_holds_a_program(comm):
    def bed(u):
        return 0.5 * 1e-3 * u[2] ** 2 * ufl.ds

    def ground(u):
        """A contact by penalty, which the body reaches when it has fallen by 0.01."""
        gap = 0.01 + u[2]
        return ufl.conditional(ufl.lt(gap, 0), 0.5 * gap**2, 0.0) * ufl.ds

    problem = program(comm, [push, bed])
    problem.solve()
    assert problem.solver.getConvergedReason() > 0
    assert "supports" not in {note.kind for note in problem.notes}
    problem = program(comm, [lambda u: -push(u), ground])
    problem.solve()
    text = problem.notes[0].text
    assert text.endswith("along z; only forces of terms that act elsewhere can hold it")
    # Without a load the solution is one of many, also of a body whose energy is a UFL form.
    free = program(comm, [lambda u: SNH.ufl(ufl.Identity(3) + ufl.grad(u)) * ufl.dx])
    free.solve()
    assert "along z; the solution is one of many" in free.notes[0].text


@pytest.mark.one_debian("ranks")
@mpi
def test_a_free_motion_in_time_is_no_mistake(comm):
    make = partial(fem_snh.DynamicProblem, densities={SNH: 1.0}, duration=0.1)
    problem = program(comm, [push], make)
    assert problem.step(0.1)
    assert "supports" not in {note.kind for note in problem.notes}
    z = problem.u.x.array[2::3]
    assert comm.allreduce(z.max(initial=0), op=MPI.MAX) > 0
