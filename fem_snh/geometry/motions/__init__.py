"""Rigid obstacles: shapes that move."""

from fem_snh.geometry.motions.moving import MovingShape, Pose, PoseTable, RigidMotion, read_motion

__all__ = ["MovingShape", "Pose", "PoseTable", "RigidMotion", "read_motion"]
