"""Rigid shapes with signed distances: what obstacles and bones are made of."""

from fem_snh.fem.shapes.box import Box
from fem_snh.fem.shapes.closed_surface import ClosedSurface
from fem_snh.fem.shapes.plane import Plane
from fem_snh.fem.shapes.records import from_record
from fem_snh.fem.shapes.round_shapes import Capsule, Cylinder, Sphere
from fem_snh.fem.shapes.shape import Evaluation, Shape
from fem_snh.fem.shapes.unions import SmoothUnion, Union

__all__ = [
    "Box", "Capsule", "ClosedSurface", "Cylinder", "Evaluation", "Plane", "Shape", "SmoothUnion",
    "Sphere", "Union", "from_record",
]  # fmt: skip
