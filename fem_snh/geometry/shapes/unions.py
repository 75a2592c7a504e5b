"""Unions of shapes, with sharp or smooth seams, and shapes from tables of a scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from fem_snh.errors import BadInput
from fem_snh.geometry.shapes.polygon import Polygon
from fem_snh.geometry.shapes.shape import (
    Array,
    Box,
    Capsule,
    Cylinder,
    Evaluation,
    Plane,
    Shape,
    Sphere,
    check_positive,
    outer,
)

#: Points whose distances are evaluated together: the arrays of one batch stay in the cache.
_BATCH = 8192
#: Weight in a smooth union below which a shape is ignored: rounding error of the sum.
_NO_WEIGHT = 1e-17


@dataclass(frozen=True)
class Union(Shape):
    r"""The union of shapes, with signed distance :math:`d = \min_i d_i`.

    Outside, d is the exact distance. Inside, where shapes overlap, the sign is right, but d may be
    smaller in size than the distance from the union's surface. At points equally close to several
    shapes the first shape is used.

    Parameters
    ----------
    shapes : tuple of Shape
        The shapes.

    Raises
    ------
    BadInput
        For no shapes.
    """

    shapes: tuple[Shape, ...]

    def __post_init__(self) -> None:
        if not len(self.shapes):
            raise BadInput("shapes = []: expected at least one shape")

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        bounds = np.array([shape.bounds for shape in self.shapes])
        return np.array([bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)])

    def distance(self, x: Array) -> Array:
        """Return the signed distance at points x (n, 3)."""
        found = np.full(len(x), np.inf)
        for batch in _batches(len(x)):
            for shape in self.shapes:
                np.minimum(found[batch], shape.distance(x[batch]), out=found[batch])
        return found

    def evaluate(self, x: Array) -> Evaluation:
        """Return signed distance, gradient and Hessian at points x (n, 3)."""
        d, first = np.full(len(x), np.inf), np.zeros(len(x), dtype=int)
        for i, shape in enumerate(self.shapes):
            other = shape.distance(x)
            first[other < d] = i
            np.minimum(d, other, out=d)
        gradient, hessian = np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
        for i, shape in enumerate(self.shapes):
            mine = first == i
            d[mine], gradient[mine], hessian[mine] = shape.evaluate(x[mine])
        return Evaluation(d, gradient, hessian)


@dataclass(frozen=True)
class SmoothUnion(Union):
    r"""The union of shapes with rounded seams, by the exponential smooth minimum.

    .. math:: d = -\frac{b}{\ln 2} \ln \sum_i e^{-\ln 2 \, d_i / b}

    For n shapes, d is between :math:`\min_i d_i - b \log_2 n` and :math:`\min_i d_i`. Where two
    surfaces meet, the surface of the union is b outside of both; where the other shape is 10 b
    away, a thousandth of b. The order of the shapes does not matter. d is no exact distance: the
    gradient is a mean of unit vectors, of length 1 away from seams and shorter near them.

    Parameters
    ----------
    shapes : tuple of Shape
        The shapes.
    blend : float
        The size b of the seams [length].

    Raises
    ------
    BadInput
        For no shapes, or if b is not positive.

    References
    ----------
    Quilez, "Smooth minimum", https://iquilezles.org/articles/smin (exponential);
    Kreisselmeier & Steinhauser 1979, Systematic control design by optimizing a vector performance
    index.
    """

    blend: float

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("blend", self.blend)

    @property
    def _scale(self) -> float:
        """The length b / ln 2 of the exponential."""
        return float(self.blend / np.log(2))

    @property
    def bounds(self) -> Array:
        """Lowest and highest coordinates, (2, 3)."""
        margin = self.blend * np.log2(len(self.shapes))
        return super().bounds + np.array([[-margin], [margin]])

    def distance(self, x: Array) -> Array:
        """Return the smooth minimum of the signed distances at points x (n, 3)."""
        found = np.empty(len(x))
        for batch in _batches(len(x)):
            found[batch] = self._minimum([shape.distance(x[batch]) for shape in self.shapes])[0]
        return found

    def evaluate(self, x: Array) -> Evaluation:
        """Return the smooth minimum at points x (n, 3), with its gradient and its Hessian."""
        d, weights = self._minimum([shape.distance(x) for shape in self.shapes])
        gradient, hessian = np.zeros((len(x), 3)), np.zeros((len(x), 3, 3))
        for shape, weight in zip(self.shapes, weights, strict=True):
            near = weight > _NO_WEIGHT
            w, (_, g, H) = weight[near], shape.evaluate(x[near])
            gradient[near] += w[:, None] * g
            hessian[near] += w[:, None, None] * (H - outer(g, g) / self._scale)
        return Evaluation(d, gradient, hessian + outer(gradient, gradient) / self._scale)

    def _minimum(self, distances: Sequence[Array]) -> tuple[Array, Array]:
        """Return the smooth minimum (n,), and its derivatives by the distances, (shapes, n)."""
        d = np.stack(distances)
        least = d.min(axis=0)
        weights = np.exp((least - d) / self._scale)
        total = weights.sum(axis=0)
        smooth: Array = least - self._scale * np.log(total)
        return smooth, weights / total


def _batches(n: int) -> list[slice]:
    return [slice(start, start + _BATCH) for start in range(0, n, _BATCH)]


#: The class of each kind of shape.
_CLASSES: dict[str, Any] = {
    kind.__name__.lower(): kind for kind in (Plane, Sphere, Cylinder, Capsule, Box, Polygon)
}
#: Keys of tables, of which one is a Python keyword, and the classes' names for them.
_RENAMED = {"from": "start", "to": "end"}


def from_record(record: Mapping[str, Any]) -> Shape:
    """Return the shape of a table of one key, e.g. ``{"sphere": {"center": ..., "radius": ...}}``.

    Parameters
    ----------
    record : mapping
        The key is the kind of the shape. The value is the table of its parameters, with the keys of
        a scene; for ``union`` it is a list of records.

    Raises
    ------
    BadInput
        For values that the shape's class does not accept.
    KeyError
        For an unknown kind.
    """
    ((kind, keys),) = record.items()
    if kind == "union":
        return Union(tuple(map(from_record, keys)))
    if kind == "smooth_union":
        return SmoothUnion(tuple(map(from_record, keys["shapes"])), keys["blend"])
    values = {key: _tuples(v) for key, v in keys.items()}
    return _CLASSES[kind](**{_RENAMED.get(key, key): v for key, v in values.items()})


def _tuples(value: Any) -> Any:
    """Return a list, and the lists in it, as tuples; any other value unchanged."""
    return tuple(map(_tuples, value)) if isinstance(value, list) else value
