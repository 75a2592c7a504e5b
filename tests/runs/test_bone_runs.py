"""Runs with bones: forces and moments, in time, resumed, files, and errors on every rank."""

from __future__ import annotations

import json

import numpy as np
import pytest
from bone_scenes import LOWER, UPPER, bar, matrix
from running import solve

from fem_snh.errors import BadInput
from fem_snh.geometry.shapes import Box, ClosedSurface
from fem_snh.viewing.render.surfaces import Obstacles
from fem_snh.viewing.stored_run import obstacle_poses

ACCURATE = {"snes_scaled_tol": 1e-11}
DENSE = {"name": "stable_neo_hookean", "E": 1e4, "nu": 0.45, "density": 1e3}
BEND = {"axis": [0, 0, 1], "through": [1, 0.5, 0.5], "angle": 0.6}


def total(bones, origin=(0.0, 0.0, 0.0)):
    """Return the sums of the bones' forces and of their moments about a point."""
    rows = list(bones.values())
    force = np.sum([b["force"] for b in rows], axis=0)
    arms = [np.subtract(b["origin"], origin) for b in rows]
    moments = [b["moment"] + np.cross(r, b["force"]) for b, r in zip(rows, arms, strict=True)]
    return force, np.sum(moments, axis=0)


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["Q1P0", "P2P1"])
def test_forces_and_moments_of_bones_balance(element):
    moved = {"name": "lower", "shape": LOWER, "rotate": BEND, "translate": [0.1, 0, 0.05]}
    upper = {"name": "upper", "shape": UPPER, "origin": [0, 0, 0]}
    result = solve(bar(upper, moved, element=element, petsc=ACCURATE))
    bones = result.record["steps"][-1]["bones"]
    assert np.linalg.norm(bones["upper"]["force"]) > 100
    force, moment = total(bones)
    assert np.abs([force, moment]).max() < 1e-5
    # The elastic moment of the bend turns the lower bone on, against the constraint.
    assert bones["upper"]["origin"] == [0, 0, 0]
    pose = np.array(bones["lower"]["pose"])
    assert bones["lower"]["origin"] == pytest.approx(pose @ [1.5, 0.5, 0.5, 1], abs=1e-12)


@pytest.mark.parametrize("time", [None, {"duration": 0.2, "steps": 4}])
def test_a_bone_that_is_a_group_moves_as_move_does(time):
    keys = {"element": "Q1P0", "material": DENSE, "petsc": ACCURATE}
    keys |= {"time": time} if time else {"steps": 2}
    bone = {"name": "first", "group": "first", "rotate": BEND}
    by_bone = solve(bar(bone, hold=[{"group": "right"}], **keys))
    move = [{"group": "first", "rotate": BEND}]
    right = [{"group": "right"}]
    by_move = solve(bar(move=move, hold=right, reactions=["first"], **keys))
    for one, other in zip(by_bone.record["steps"], by_move.record["steps"], strict=True):
        force = one["bones"]["first"]["force"]
        assert force == pytest.approx(other["reactions"]["first"], rel=1e-7, abs=1e-4)
        for key in ("kinetic", "elastic") if time else ("energy",):
            # In time, velocities are differences of displacements, which differ by rounding.
            assert one[key] == pytest.approx(other[key], rel=1e-7 if time else 1e-9)


@pytest.mark.mpi
@pytest.mark.parametrize(
    "bone, message",
    [
        ({"shape": {"sphere": {"center": [0, 0, 3], "radius": 0.5}}},
         "bone 'bone_0': expected a bone that holds a node of the mesh: the closest one is 1.5"),
        ({"group": "top"}, "bone.group = 'top': expected a group of volumes, not a surface:top"),
        ({"group": "furst"}, r"no physical group 'furst' in the mesh \(did you mean 'first'\?\)"),
        ({"shape": {"sphere": {"center": [0, 0, 1], "radius": 9}}},
         "bone: 'bone_0' hold all nodes of the body: expected a free node"),
        ({"surface": "none.stl"}, "cannot read the surface none.stl"),
        ({"shape": UPPER, "motion": "none.csv"}, "cannot read the motion none.csv"),
        ({"shape": UPPER, "motion": lambda load: np.eye(3)}, "at load .*: expected a 3x4 matrix"),
    ],
)  # fmt: skip
def test_mistakes_are_one_line_on_every_rank(bone, message):
    with pytest.raises(BadInput, match=message) as error:
        solve(bar(bone))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    "keys, message",
    [
        ({}, "bone.0: expected one of the keys shape, surface, group; found none"),
        ({"shape": UPPER, "group": 1}, "bone.0: expected one of .*; found shape, group"),
        ({"shape": UPPER, "motion": 3}, "bone.0.motion = 3: expected the path of a CSV file"),
        ({"shape": UPPER, "motion": "a.csv", "translate": [0, 0, 1]}, "exclude each other"),
        ({"shape": UPPER, "rigid": True}, "rigid = True: expected no value without the CSV file"),
        ({"shape": UPPER, "table": "ramp"}, "missing key 'translate' or 'rotate'"),
    ],
)
def test_mistakes_of_the_table(keys, message):
    from fem_snh import scenes

    with pytest.raises(BadInput, match=message):
        scenes.load(bar(), bone=[{"name": "a", **keys}])


CUBE = [[x, y, z] for z in (0.2, 0.8) for y in (0.2, 0.8) for x in (0.2, 0.8)]
FACES = [[1, 3, 4, 2], [5, 6, 8, 7], [1, 2, 6, 5], [3, 7, 8, 4], [1, 5, 7, 3], [2, 4, 8, 6]]


@pytest.fixture
def obj(tmp_path):
    """Return an OBJ file of a cube [0.2, 0.8]^3, with quadrilaterals."""
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE]
    lines += ["f " + " ".join(map(str, face)) for face in FACES]
    (tmp_path / "cube.obj").write_text("\n".join(lines) + "\n")
    return tmp_path / "cube.obj"


@pytest.mark.one_debian
def test_the_surface_of_an_obj_file(obj, tmp_path):
    X = np.random.default_rng(0).uniform(0, 1, (200, 3))
    box = Box((0.5, 0.5, 0.5), (0.6, 0.6, 0.6))
    found = ClosedSurface.read(obj)
    assert len(found.triangles) == 12
    assert found.distance(X) == pytest.approx(box.distance(X), abs=1e-6)
    (tmp_path / "points.obj").write_text("v 0 0 0\n")
    with pytest.raises(BadInput, match="expected an OBJ file with faces, found none"):
        ClosedSurface.read(tmp_path / "points.obj")


def test_a_surface_holds_the_nodes_of_its_shape_and_is_drawn(obj, tmp_path):
    box = {"box": {"center": [0.5, 0.5, 0.5], "size": [0.6, 0.6, 0.6]}}
    skew = matrix([[1.1, 0.2, 0.0], [-0.1, 0.95, 0.05], [0.0, 0.1, 1.0]], (0.05, 0, 0.03))

    def move(load):
        return (1 - load) * matrix(np.eye(3)) + load * skew

    scene = bar({"name": "cube", "surface": obj, "motion": move}, hold=[{"group": "right"}])
    out = tmp_path / "out"
    surface = solve(scene, out=out).record["steps"][-1]
    shape = solve(bar({"shape": box, "motion": move}, hold=[{"group": "right"}]))
    assert surface["energy"] == pytest.approx(shape.record["steps"][-1]["energy"], rel=1e-9)
    assert surface["bones"]["cube"]["pose"] == pytest.approx(skew)
    (drawn,) = obstacle_poses(json.loads((out / "run.json").read_text()), out)
    ((_, picture),) = Obstacles([drawn]).at(1.0, np.array([[0.0, 0, 0], [2, 1, 1]]))
    corners = np.array(CUBE) @ skew[:, :3].T + skew[:, 3]
    assert np.ptp(picture.points, axis=0) == pytest.approx(np.ptp(corners, axis=0), abs=1e-6)
