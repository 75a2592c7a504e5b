"""Shapes from the tables of a scene and of run.json."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fem_snh.geometry.shapes.box import Box, Plane
from fem_snh.geometry.shapes.polygon import Polygon
from fem_snh.geometry.shapes.round_shapes import Capsule, Cylinder, Sphere
from fem_snh.geometry.shapes.shape import Shape
from fem_snh.geometry.shapes.unions import SmoothUnion, Union

#: The class of each kind of shape.
_CLASSES: dict[str, Any] = {
    "plane": Plane,
    "sphere": Sphere,
    "cylinder": Cylinder,
    "capsule": Capsule,
    "box": Box,
    "polygon": Polygon,
}
#: Keys of tables that are words of Python, and their names in the classes.
_RENAMED = {"from": "start", "to": "end"}


def from_record(record: Mapping[str, Any]) -> Shape:
    """Return the shape of a table of one key, e.g. ``{"sphere": {"center": ..., "radius": ...}}``.

    Parameters
    ----------
    record : mapping
        The key names the kind of the shape. Its value has the keys of the scene's table, or is the
        list of such tables for ``union``.

    Raises
    ------
    BadInput
        For values that no shape has.
    KeyError
        For an unknown kind.
    """
    ((kind, keys),) = record.items()
    if kind == "union":
        return Union(tuple(map(from_record, keys)))
    if kind == "smooth_union":
        return SmoothUnion(tuple(map(from_record, keys["shapes"])), keys["blend"])
    values = {key: _tuples(v) for key, v in keys.items()}
    shape: Shape = _CLASSES[kind](**{_RENAMED.get(key, key): v for key, v in values.items()})
    return shape


def _tuples(value: Any) -> Any:
    """Return lists, and lists in lists, as tuples."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
