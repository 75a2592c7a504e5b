"""Rigid obstacles: shapes that move."""

from fem_snh.geometry.motions.moving import Obstacle, Pose, RigidMotion
from fem_snh.geometry.motions.pose_table import PoseTable, read_motion

__all__ = ["Obstacle", "Pose", "PoseTable", "RigidMotion", "read_motion"]
