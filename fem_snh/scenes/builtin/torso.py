"""The torso of Smith et al. 2018, Figure 1: flesh on 13 bones, arms swung across the chest."""

from __future__ import annotations

from typing import Any

import numpy as np

from fem_snh.scenes import Scene
from fem_snh.scenes._bones import BoneSegment, JointMotion, capsule, lattice_scene, limb

#: x points to the body's left, y to its back, z up [m]. The tables hold the left side; the right
#: one is its mirror image, except for the pose.
SIDES = {"left": (1, 1, 1), "right": (-1, 1, 1)}
#: Bones of the trunk, which stands still: ends and radius.
TRUNK = {
    "lumbar_spine": ((0, 0.03, -0.02), (0, 0.04, 0.18), 0.028),
    "thorax": ((0, 0.01, 0.24), (0, 0.03, 0.42), 0.06),
    "neck": ((0, 0.02, 0.5), (0, 0.005, 0.65), 0.022),
}
#: Joints of an arm from the sternum to the fingertips; its bones: radius, distance of their ends
#: from the joints.
ARM = np.array([
    (0.02, -0.04, 0.475), (0.18, 0.01, 0.49), (0.42, 0.015, 0.38), (0.635, 0, 0.285),
    (0.76, -0.005, 0.23),
])  # fmt: skip
ARM_BONES = {
    "clavicle": (0.011, 0.02),
    "humerus": (0.018, 0.03),
    "forearm": (0.017, 0.016),
    "hand": (0.012, 0.03),
}
#: The shoulder blade, which moves with the clavicle.
SCAPULA = ((0.07, 0.075, 0.35), (0.145, 0.045, 0.475), 0.014)
#: Directions of an arm's bones across the chest: the left arm passes above the right one.
SWUNG = {
    "left": ((0.96, -0.25, 0), (-0.55, -0.8, -0.12), (-0.93, 0.25, 0.1), (-0.85, 0.45, 0.1)),
    "right": ((0.96, -0.25, 0), (-0.5, -0.72, -0.6), (-0.93, 0.25, 0), (-0.85, 0.45, 0.05)),
}
#: Flesh of the left half: belly, chest, breast, shoulder; ends and radius.
FLESH = (
    ((0.065, 0, 0.02), (0.055, 0, 0.2), 0.095),
    ((0.075, 0, 0.24), (0.08, 0.01, 0.41), 0.1),
    ((0.03, -0.055, 0.37), (0.125, -0.04, 0.42), 0.052),
    ((0.02, 0.015, 0.5), (0.17, 0.01, 0.49), 0.056),
)
#: Flesh in the middle: belly, chest, neck.
MIDDLE = (
    ((0, 0.01, 0.02), (0, 0.015, 0.2), 0.1),
    ((0, 0.01, 0.22), (0, 0.015, 0.42), 0.1),
    ((0, 0.01, 0.52), (0, -0.005, 0.64), 0.055),
)
#: Flesh of an arm: pieces between fractions of the way from one joint to the next, and their radii.
ARM_FLESH = (
    (1, 0.0, 0.5, 0.056), (1, 0.5, 1.0, 0.047), (2, 0.0, 0.45, 0.043), (2, 0.45, 1.0, 0.034),
)  # fmt: skip
#: The hand's flesh: radius, distance of its two edges from the axis, and of its end from the tip.
HAND = (0.024, 0.016, 0.026)
BLEND = 0.0083
#: Load steps: the arms swing in a second of film.
FRAMES = 24
#: Distance from fingertip to fingertip [m].
SPAN = 1.51


def torso(cells: int = 144, noise: float = 0.0, seed: int = 1, contact: bool = True) -> Scene:
    """A torso whose arms swing across the chest, driven by 13 bones.

    Parameters
    ----------
    cells : int
        Cells from fingertip to fingertip: 144 give 45,800 in all, 60 give 4,000.
    noise : float
        Noise of the bones' affine maps, relative to the length of the bone.
    seed : int
        Seed of the noise.
    contact : bool
        Whether the surface has self-contact.
    """
    keys = {"name": "torso", "element": "Q1P0", "steps": FRAMES, "load_name": "swing"}
    return Scene(**lattice_scene(flesh(), SPAN / cells, rig(), noise, seed, contact, **keys))


def rig() -> list[BoneSegment]:
    """Return the bones of the torso [m]."""
    trunk = JointMotion((0.0, 0.0, 0.0))
    bones = [BoneSegment(name, trunk, *ends_and_radius) for name, ends_and_radius in TRUNK.items()]
    for side, mirror in SIDES.items():
        names = [f"{side}_{name}" for name in ARM_BONES]
        arm = limb(trunk, names, ARM * mirror, np.multiply(SWUNG[side], mirror), ARM_BONES.values())
        start, end, radius = SCAPULA
        ends = np.multiply(start, mirror), np.multiply(end, mirror)
        bones += [*arm, BoneSegment(f"{side}_scapula", arm[0].joint, *ends, radius)]
    return bones


def flesh() -> dict[str, Any]:
    """Return the table of the body's shape: a smooth union of capsules [m]."""
    shapes = [capsule(a, b, r) for a, b, r in MIDDLE]
    for mirror in SIDES.values():
        shapes += [capsule(np.multiply(a, mirror), np.multiply(b, mirror), r) for a, b, r in FLESH]
        joints = ARM * mirror
        for k, begin, end, radius in ARM_FLESH:
            a, b = (joints[k] + part * (joints[k + 1] - joints[k]) for part in (begin, end))
            shapes.append(capsule(a, b, radius))
        radius, edge, short = HAND
        wrist, tip = joints[-2:]
        tip = tip - short * (tip - wrist) / np.linalg.norm(tip - wrist)
        for aside in (np.array([0, edge, 0]), np.array([0, -edge, 0])):
            shapes.append(capsule(wrist + aside, tip + aside, radius))
    return {"smooth_union": {"shapes": shapes, "blend": BLEND}}
