"""Forward kinematics of joints, and the skeletons of the scenes hand and torso."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fem_snh.scenes._bones import JointMotion, limb
from fem_snh.scenes.builtin import hand, torso

SHOULDER = JointMotion((0.1, 0.2, 0.3), (0.3, -0.4, 0.9))
ELBOW = JointMotion((1.1, 0.2, 0.4), (0.0, 1.2, -0.5), SHOULDER, begin=0.25)
WRIST = JointMotion((2.0, 0.1, 0.4), (-0.7, 0.0, 0.2), ELBOW)
BODY = JointMotion((0.0, 0.0, 0.0))
RIGS = pytest.mark.parametrize("scene", [hand, torso], ids=lambda scene: scene.__name__[-5:])


def apply(affine: np.ndarray, x: object) -> np.ndarray:
    return affine[:, :3] @ np.asarray(x) + affine[:, 3]


@pytest.mark.parametrize("load", [0.1, 0.6, 1.0])
def test_joints_turn_what_hangs_on_them(load):
    x = moved = np.array([2.5, -0.3, 0.8])
    for joint in (
        WRIST,
        ELBOW,
        SHOULDER,
    ):  # the last one turns first
        part = max(0.0, (load - joint.begin) / (1 - joint.begin))
        turn = Rotation.from_rotvec(part * np.array(joint.rotation))
        moved = joint.position + turn.apply(moved - joint.position)
    assert apply(WRIST(load), x) == pytest.approx(moved, abs=1e-14)


def test_limb_points_where_it_is_told():
    points = np.array([(0, 0, 0), (1, 0, 0.2), (1.5, 0.3, 0.1), (1.9, 0.2, 0.0)])
    wanted = np.array([(0.2, 1, 0.3), (-1, 0.1, 0), (-1, 0.1, 0)])
    maps = [bone.joint(1.0) for bone in limb(BODY, "abc", points, wanted, [(0.1, 0.0)] * 3)]
    for affine, a, b, direction in zip(maps, points, points[1:], wanted, strict=False):
        found = apply(affine, b) - apply(affine, a)
        length = np.linalg.norm(b - a)
        assert found == pytest.approx(length * direction / np.linalg.norm(direction), abs=1e-14)
    for affine, following, x in zip(maps, maps[1:], points[1:], strict=False):
        assert apply(affine, x) == pytest.approx(apply(following, x), abs=1e-14)


@RIGS
def test_rigs_start_at_rest_and_move_rigidly(scene):
    bones = scene.rig()
    assert len(bones) == {hand: 24, torso: 13}[scene]
    for bone in bones:
        motion = bone.joint
        assert motion(0.0) == pytest.approx(np.eye(3, 4), abs=1e-15)
        R = motion(1.0)[:, :3]
        assert R @ R.T == pytest.approx(np.eye(3), abs=1e-14)
        assert np.linalg.det(R) == pytest.approx(1.0)


@RIGS
def test_bones_are_within_the_flesh(scene):
    from fem_snh.geometry.shapes import from_record

    body = from_record(scene.flesh())
    for bone in scene.rig():
        on_axis = np.linspace(bone.start, bone.end, 9)
        assert body.distance(on_axis).max() < -bone.radius, bone.name
