"""Rigid obstacles: shapes that move."""

from fem_snh.geometry.motions.moving import Obstacle, Pose, PoseTable, RigidMotion, read_motion

__all__ = ["Obstacle", "Pose", "PoseTable", "RigidMotion", "read_motion"]
