"""Rigid shapes with signed distances: what obstacles and bones are made of."""

from fem_snh.geometry.shapes.box import Box, Plane
from fem_snh.geometry.shapes.closed_surface import ClosedSurface
from fem_snh.geometry.shapes.polygon import Polygon, read_polygon
from fem_snh.geometry.shapes.records import from_record
from fem_snh.geometry.shapes.round_shapes import Capsule, Cylinder, Revolved, Sphere
from fem_snh.geometry.shapes.shape import Evaluation, Shape, deepest
from fem_snh.geometry.shapes.unions import SmoothUnion, Union

__all__ = [
    "Box", "Capsule", "ClosedSurface", "Cylinder", "Evaluation", "Plane", "Polygon", "Revolved",
    "Shape", "SmoothUnion", "Sphere", "Union", "deepest", "from_record", "read_polygon",
]  # fmt: skip
