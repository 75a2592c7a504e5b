"""Rigid obstacles: shapes that move."""

from fem_snh.geometry.motions.moving import Motion, Obstacle, Pose
from fem_snh.geometry.motions.pose_table import PoseTable, read_motion

__all__ = ["Motion", "Obstacle", "Pose", "PoseTable", "read_motion"]
