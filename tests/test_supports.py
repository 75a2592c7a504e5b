"""Rigid motions that nothing constrains: they are named before the first step."""

from __future__ import annotations

import pytest
from running import solve

from fem_snh.errors import BadInput
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Obstacle, Rigid, Scene, Spring, Traction

mpi = pytest.mark.mpi


def block(mesh=None, **keys):
    return Scene(
        name="block",
        mesh=mesh or Geometry(source="cube"),
        cells=2,
        element="Q1",
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
        **keys,
    )


def supports(comm, scene):
    """Return the text of the note on supports; empty without one."""
    notes = solve(scene, comm).record.get("notes", [])
    return next((note["text"] for note in notes if note["kind"] == "supports"), "")


def roller(group, axis):
    return Hold(group=group, components=(axis,))


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
    assert text.startswith(f"nothing constrains {free}" if free else "") and bool(text) == bool(
        free
    )


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
def test_the_part_that_is_free_is_named(comm):
    two = Geometry(source="two_blocks", parameters={"gap": 0.5, "upper_cells": 1})
    text = supports(comm, block(two, hold=[Hold(group="bottom"), roller("top", "z")]))
    assert "the rotation about z of part 2, 8 nodes" in text
    # Contact may hold it.
    plane = Obstacle(shape={"plane": {"point": (0, 0, 3), "normal": (0, 0, -1)}})
    held = block(two, hold=[Hold(group="bottom"), roller("top", "z")], obstacle=[plane])
    assert supports(comm, held).endswith("; contact alone can hold it")


@mpi
def test_rigid_parts_and_joints_constrain(comm):
    two = Geometry(source="two_blocks", parameters={"gap": 0.5})
    hinge = {"kind": "hinge", "axis": (0, 1, 0), "through": (0, 0.5, 1.25)}
    lid = Rigid(group="upper_bottom", joint=hinge)
    text = supports(comm, block(two, hold=[Hold(group="bottom")], rigid=[lid]))
    assert text.startswith("nothing constrains the rotation about y of part ")
    turned = Rigid(group="upper_bottom", joint=hinge, torque=(0, 1, 0))
    with pytest.raises(BadInput, match=r"rotation about y.*loads act"):
        solve(block(two, hold=[Hold(group="bottom")], rigid=[turned]), comm)
    sprung = Rigid(group="upper_bottom", joint=hinge, spring={"rotation": 1.0})
    assert supports(comm, block(two, hold=[Hold(group="bottom")], rigid=[sprung])) == ""
    carried = Rigid(
        group="upper_bottom", joint=hinge | {"kind": "ball", "axis": None, "to": "base"}
    )
    base = Rigid(group="lower_top", name="base")
    text = supports(comm, block(two, hold=[Hold(group="bottom")], rigid=[base, carried]))
    assert text.count("the rotation about") == 3 and "translation" not in text
