"""Drucker stability: the region of stretches in which the exact tangent is positive.

The tangent is the 9x9 Hessian d2psi/dF2. Smith et al. 2018 (section 3.3) relate its positive
semidefiniteness to Drucker's stability. Under compression the tangent of every material is
indefinite: the twist eigenvalues (p_j + p_k)/(s_j + s_k) are negative, because a compressed element
may rotate as a strut buckles. The region of the three scaling eigenvalues alone, which excludes
rotations, is therefore reported as well.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from fem_snh.kernels.material import Material
from fem_snh.kernels.reports.curves import (
    EQUIBIAXIAL,
    UNIAXIAL,
    Array,
    Curve,
    Test,
    eigenvalues,
    free_stretch,
)

#: Planes of stretches: the third stretch as a function of the two others.
PLANES: dict[str, Callable[[Array, Array], Array]] = {
    "s2 = 1": lambda a, b: np.ones_like(a),
    "s2 = s1": lambda a, b: b,
}
#: Eigenvalues above -TOLERANCE [E] count as non-negative: three are rounding errors of 0 at rest.
TOLERANCE = 1e-8


@dataclass(frozen=True)
class StableRegion:
    """Smallest eigenvalues [Pa] over a plane of stretches; NaN where psi is infinite.

    Attributes
    ----------
    plane : str
        Key of `PLANES`.
    s0, s1 : numpy.ndarray
        The axes (n,).
    tangent, scaling : numpy.ndarray
        Smallest of all eigenvalues and of the three scaling eigenvalues (n, n), rows for s1.
    """

    plane: str
    s0: Array
    s1: Array
    tangent: Array
    scaling: Array


@dataclass(frozen=True)
class Interval:
    """The stretches around rest for which the tangent stays positive along a path.

    Attributes
    ----------
    path : str
        Name of the curve.
    searched : tuple of float
        Range of the path; an interval that ends there may extend further.
    tangent, scaling : tuple of float or None
        (from, to) for all eigenvalues and for the scaling eigenvalues; None if the tangent is not
        positive at rest.
    """

    path: str
    searched: tuple[float, float]
    tangent: tuple[float, float] | None
    scaling: tuple[float, float] | None


def smallest(m: Material, s: Array) -> tuple[Array, Array]:
    """Return the smallest of all and of the scaling eigenvalues [Pa] at stretches (..., 3)."""
    values = eigenvalues(m, s)
    return values.min(axis=-1), values[..., :3].min(axis=-1)


def region(m: Material, plane: str, axis: Array | None = None) -> StableRegion:
    """Return the smallest eigenvalues over a plane; ``axis`` (n,) holds both axes' stretches."""
    axis = np.linspace(0.01, 3, 300) if axis is None else np.asarray(axis, dtype=float)
    s0, s1 = np.meshgrid(axis, axis)
    s = np.stack([s0, s1, PLANES[plane](s0, s1)], axis=-1)
    return StableRegion(plane, axis, axis, *smallest(m, s))


def regions(m: Material) -> tuple[StableRegion, ...]:
    """Return the regions of all planes."""
    return tuple(region(m, plane) for plane in PLANES)


def intervals(m: Material, curves: tuple[Curve, ...]) -> tuple[Interval, ...]:
    """Return the intervals of all curves that have stretches (all but the shear)."""
    return tuple(interval(m, curve) for curve in curves if curve.stretches is not None)


def interval(m: Material, curve: Curve) -> Interval:
    """Return the interval around rest in which the smallest eigenvalue is not negative."""
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
    """Return the end of the interval between a positive sample ``a`` and a negative ``b``."""
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
