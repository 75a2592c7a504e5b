"""Bones: solids in the flesh whose nodes follow a prescribed affine motion."""

from fem_snh.geometry.bones.bvh import Clip, read_bvh
from fem_snh.geometry.bones.motions import (
    AffineMotion,
    AffineTable,
    Bone,
    FunctionMotion,
    Noise,
    RigidAffine,
    bone_motion,
)
from fem_snh.geometry.bones.skeleton import Placement, joint_motion

__all__ = [
    "AffineMotion",
    "AffineTable",
    "Bone",
    "Clip",
    "FunctionMotion",
    "Noise",
    "Placement",
    "RigidAffine",
    "bone_motion",
    "joint_motion",
    "read_bvh",
]  # fmt: skip
