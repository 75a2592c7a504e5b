"""Rigid parts that are shapes in the flesh: bones that forces move."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx_programs import converged
from rigid_bodies import corner_program
from running import record, solve
from shape_scenes import ELBOW, HINGE, LOWER, TIGHT, UPPER, arm, parts

import fem_snh
from fem_snh.errors import BadInput
from fem_snh.geometry.rotations import exponential
from fem_snh.scenes import BoneChoice, Geometry, Hold, Rigid
from fem_snh.viewing.stored_run import obstacle_poses

mpi = pytest.mark.mpi


def bones(angle):
    turn = {"axis": (0, 0, 1), "through": ELBOW, "angle": angle}
    return [
        BoneChoice(name="upper", shape=UPPER),
        BoneChoice(name="lower", shape=LOWER, rotate=turn, origin=ELBOW),
    ]


@pytest.mark.one_debian
@mpi
def test_elbow_that_a_torque_flexes_is_inverse_to_the_motion_of_bones(comm):
    flexed = solve(arm(rigid=parts(joint=HINGE | {"torque": 500.0})), comm)
    assert flexed.converged
    state = flexed.record["steps"][-1]["rigid"]
    angle = state["lower"]["rotation"][2]
    assert angle > 0.2
    assert state["lower"]["moment"][2] == pytest.approx(500.0, rel=1e-8)
    moved = solve(arm(bone=bones(angle)), comm)
    found = moved.record["steps"][-1]["bones"]
    assert flexed.problem.u.x.array == pytest.approx(moved.problem.u.x.array, abs=1e-8)
    for name in ("upper", "lower"):
        assert state[name]["force"] == pytest.approx(found[name]["force"], abs=1e-5)
    assert found["lower"]["moment"][2] == pytest.approx(500.0, rel=1e-7)


@mpi
def test_shape_is_the_group_of_its_cells(comm):
    turn = {"axis": (0, 1, 0.3), "angle": 0.3, "through": (0.75, 0.5, 0.75)}
    box = {"box": {"center": (0.75, 0.5, 0.75), "size": (0.5, 1.0, 0.5)}}
    states = []
    for part in ({"tag": 2}, {"name": "dx(2)", "shape": box}):
        program = corner_program(comm, [part | {"rotate": turn}], petsc_options=TIGHT)
        program.solve()
        assert converged(program)
        states.append(program._problem.rigid_states(program.x)["dx(2)"])
    assert states[0].keys() == states[1].keys() and states[0]
    for key, values in states[0].items():
        assert states[1][key] == pytest.approx(values, abs=1e-7), key


@pytest.mark.one_debian
def test_pictures_have_the_pose_of_a_shape(tmp_path):
    scene = arm(rigid=parts(joint=HINGE | {"torque": 500.0}), steps=2)
    solve(scene, out=tmp_path / "out")
    found = record(tmp_path / "out")
    upper, lower = obstacle_poses(found, tmp_path / "out")
    assert upper["poses"][-1] == pytest.approx(np.eye(3, 4), abs=1e-12)
    assert lower["kind"] == "rigid" and lower["loads"] == [0.0, 0.5, 1.0]
    R = exponential(np.array(found["steps"][-1]["rigid"]["lower"]["rotation"]))
    pose = np.array(lower["poses"][-1])
    assert pose[:, :3] == pytest.approx(R, abs=1e-12)
    assert pose @ [*ELBOW, 1.0] == pytest.approx(ELBOW, abs=1e-9)
    assert [one["kind"] for one in obstacle_poses(found, tmp_path / "out", hide=["upper"])] == [
        "rigid"
    ]


def test_surface_of_a_file_is_copied_to_the_folder(tmp_path):
    import pyvista

    pyvista.Sphere(radius=0.4, center=(0.75, 0.5, 0.5)).save(tmp_path / "ball.stl")
    ball = Rigid(name="ball", surface=tmp_path / "ball.stl", translate=(0, 0.1, 0))
    hold = [{"name": "lower", "shape": LOWER, "translate": (0, 0, 0)}]
    solve(arm(rigid=[ball, *map(Rigid.model_validate, hold)]), out=tmp_path / "out")
    first, second = obstacle_poses(record(tmp_path / "out"), tmp_path / "out")
    assert first["shape"] == {"surface": str(tmp_path / "out/rigid_0.stl")}
    assert (tmp_path / "out/rigid_0.stl").read_bytes() == (tmp_path / "ball.stl").read_bytes()
    assert second["shape"].keys() == {"capsule"}
    assert first["poses"][-1] == pytest.approx(np.column_stack([np.eye(3), [0, 0.1, 0]]), abs=1e-9)
    fem_snh.run("twist", cells=1, steps=1, out=tmp_path / "out", overwrite=True, progress=False)
    assert not (tmp_path / "out/rigid_0.stl").exists()


@mpi
@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"shape": {"sphere": {"center": (9, 0, 0), "radius": 1}}}, "part with nodes of the body"),
        (
            {"shape": {"plane": {"point": (0, 0, 0.3)}}},
            "'about', a point, with a shape that has no",
        ),
    ],
)
def test_shapes_that_do_not_fit_are_refused_on_every_rank(comm, keys, message):
    with pytest.raises(BadInput, match=message):
        solve(arm(rigid=[Rigid(name="part", **keys)]), comm)


@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({}, "expected one of the keys group, shape, surface; found none"),
        ({"group": "top", "shape": LOWER}, "found group, shape"),
        ({"shape": LOWER}, "missing key 'name': expected with 'shape'"),
    ],
)
def test_a_part_is_one_thing_and_a_shape_has_a_name(keys, message):
    with pytest.raises(BadInput, match=message):
        fem_snh.Rigid(**keys)


@pytest.mark.one_debian
def test_polygon_has_a_middle_in_the_plane():
    corners = [(10, 10), (25, 12), (20, 30)]
    part = Rigid(name="part", shape={"polygon": {"points": corners}}, translate=(0, 1, 0))
    scene = arm(
        cells=12, mesh=Geometry(source="cook"), kinematics="plane_strain", hold=[Hold(group="left")]
    )
    scene = scene.model_copy(update={"rigid": [part]})
    state = solve(scene).steps[-1]["rigid"]["part"]
    assert state["position"] == pytest.approx((17.5, 21, 0), abs=1e-9)
