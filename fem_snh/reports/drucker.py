"""Where the exact tangent is positive: the region of stretches, and intervals along loading paths.

The tangent is the 9x9 Hessian d2psi/dF2. Positive semidefinite, it is what the paper (section 3.3)
relates to Drucker's stability. Under compression it is not, whatever the material: a compressed
element may turn (the twist eigenvalues (p_j + p_k)/(s_j + s_k)), as a strut buckles. Therefore what
holds of the three scaling eigenvalues alone, turning excluded, is told beside it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fem_snh.kernels.pointwise import Material
from fem_snh.reports.curves import EQUIBIAXIAL, UNIAXIAL, Curve, Test, free_stretch
from fem_snh.reports.evaluate import Array, eigenvalues

#: Planes of stretches: what the third one is, given two.
PLANES: dict[str, Callable[[Array, Array], Array]] = {
    "s2 = 1": lambda a, b: np.ones_like(a),
    "s2 = s1": lambda a, b: b,
}
TOLERANCE = 1e-8  # of E: at rest three eigenvalues are 0, and rounding is not instability


@dataclass(frozen=True)
class Region:
    """Smallest eigenvalues [Pa] over a plane of stretches; NaN where psi is infinite.

    s0, s1 : the axes (n,).
    tangent, scaling : (n, n), rows for s1: of all nine eigenvalues, of the three scaling ones.
    """

    plane: str
    s0: Array
    s1: Array
    tangent: Array
    scaling: Array


@dataclass(frozen=True)
class Interval:
    """The stretches around rest for which the tangent stays positive along a path.

    tangent, scaling : (from, to), or None if it is not even so at rest.
    searched : the path's own range; an end equal to it is no end.
    """

    path: str
    searched: tuple[float, float]
    tangent: tuple[float, float] | None
    scaling: tuple[float, float] | None


def smallest(m: Material, s: Array) -> tuple[Array, Array]:
    """The smallest of all nine and of the three scaling eigenvalues [Pa], stretches (..., 3)."""
    values = eigenvalues(m, s)
    return values.min(axis=-1), values[..., :3].min(axis=-1)


def region(m: Material, plane: str, axis: Array | None = None) -> Region:
    """The map over a plane of `PLANES`; ``axis`` (n,) are the stretches of both axes."""
    axis = np.linspace(0.01, 3, 300) if axis is None else np.asarray(axis, dtype=float)
    s0, s1 = np.meshgrid(axis, axis)
    s = np.stack([s0, s1, PLANES[plane](s0, s1)], axis=-1)
    return Region(plane, axis, axis, *smallest(m, s))


def regions(m: Material) -> tuple[Region, ...]:
    """The maps over all planes."""
    return tuple(region(m, plane) for plane in PLANES)


def intervals(m: Material, curves: tuple[Curve, ...]) -> tuple[Interval, ...]:
    """For each of the curves that has stretches, i.e. all but the shear."""
    return tuple(interval(m, curve) for curve in curves if curve.stretches is not None)


def interval(m: Material, curve: Curve) -> Interval:
    """The part of a path, around rest, where the smallest eigenvalue is not negative."""
    assert curve.stretches is not None
    known = np.isfinite(curve.stretches).all(axis=-1)
    x, s = curve.x[known], curve.stretches[known]
    if not len(x):
        return Interval(curve.name, (1.0, 1.0), None, None)
    pieces = [
        _around_rest(m, curve.name, x, s, values >= -TOLERANCE * m.expression.E, which)
        for which, values in enumerate(smallest(m, s))
    ]
    return Interval(curve.name, (float(x[0]), float(x[-1])), *pieces)


def _around_rest(
    m: Material, path: str, x: Array, s: Array, good: npt.NDArray[np.bool_], which: int
) -> tuple[float, float] | None:
    rest = int(np.argmin(np.abs(x - 1)))
    if not good[rest]:
        return None
    bad = np.flatnonzero(~good)
    below, above = bad[bad < rest], bad[bad > rest]
    low = _edge(m, path, x, s, below[-1] + 1, below[-1], which) if len(below) else float(x[0])
    high = _edge(m, path, x, s, above[0] - 1, above[0], which) if len(above) else float(x[-1])
    return low, high


def _edge(m: Material, path: str, x: Array, s: Array, a: int, b: int, which: int) -> float:
    """Between sample ``a``, where the tangent is positive, and ``b``, where not: by bisection."""
    good, bad = float(x[a]), float(x[b])
    for _ in range(26):
        middle = (good + bad) / 2
        here = _stretches(m, path, middle, float(s[a, 2]))
        if smallest(m, here)[which] >= -TOLERANCE * m.expression.E:
            good = middle
        else:
            bad = middle
    return good


_TESTS: dict[str, Test] = {"uniaxial": UNIAXIAL, "equibiaxial": EQUIBIAXIAL}


def _stretches(m: Material, path: str, x: float, guess: float) -> Array:
    if path not in _TESTS:
        return np.full(3, x)
    t = free_stretch(m, _TESTS[path], x, guess)
    return _TESTS[path][0](np.array(x), np.array(t))
