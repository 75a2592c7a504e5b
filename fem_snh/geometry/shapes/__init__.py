"""Rigid shapes with signed distances: what obstacles and bones are made of."""

from fem_snh.geometry.shapes.closed_surface import ClosedSurface
from fem_snh.geometry.shapes.polygon import Polygon
from fem_snh.geometry.shapes.shape import (
    Box,
    Capsule,
    Cylinder,
    Evaluation,
    Plane,
    Revolved,
    Shape,
    Sphere,
    deepest,
)
from fem_snh.geometry.shapes.unions import SmoothUnion, Union, from_record

__all__ = [
    "Box", "Capsule", "ClosedSurface", "Cylinder", "Evaluation", "Plane", "Polygon", "Revolved",
    "Shape", "SmoothUnion", "Sphere", "Union", "deepest", "from_record",
]  # fmt: skip
