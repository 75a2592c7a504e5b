"""Rigid parts that are shapes in the flesh: bones that forces move."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx_programs import converged
from rigid_bodies import corner_program
from running import record, solve
from shape_scenes import ELBOW, HINGE, LOWER, TIGHT, UPPER, arm, parts

import fem_snh
from fem_snh.scenes import BoneChoice, Rigid
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
