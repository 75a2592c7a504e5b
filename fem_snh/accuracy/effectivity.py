r"""The one rule of bounds: what levels of a discretisation say of the error on the last of them.

A level has the values v of a vector and the estimate e of what is to be added to them. Two levels
measure the estimate, by the change that came over the change that it predicted:

.. math:: \theta = (v_k - v_{k-1}) \cdot (e_{k-1} - e_k) / \lvert e_{k-1} - e_k \rvert^2

If all levels miss the same part of the error, :math:`v + \theta e` is exact. What a level is does
not matter: a mesh, whose estimate is from a better element; a number of steps, or a stiffness of
penalties, of order p, whose estimate is :math:`d/(r^p - 1)` of the last change d by a factor r:
then the rule is Aitken's. docs/theory/error.md derives it, and says what breaks it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from fem_snh.arrays import Array

#: What a better discretisation leaves of an error, at most: a third, as Richardson's with order
#: log2(3) on halved cells. The error is then 3/4 to 3/2 of the estimate, which misses at most half
#: of itself.
_SATURATION = 1 / 3
MISSED = _SATURATION / (1 - _SATURATION)
#: Least bound of a component over the largest one of its vector: the estimate of a component that
#: changes its sign is small by chance, and a vector's direction is known to a fifth.
OF_VECTOR = 0.2
#: Largest ratio of two estimates with which a change that they do not explain is continued.
_SLOWEST = 0.8


class Measured(NamedTuple):
    """What levels say of a vector on the last one.

    Attributes
    ----------
    theta : float
        The measured effectivity.
    factor : float
        Of the estimate, in what is added to the values.
    bounds : (n,) array
        Bounds of the errors of values with that added.
    confirmed : bool
        Whether the effectivity confirms the estimate, or that of the levels before.
    """

    theta: float
    factor: float
    bounds: Array
    confirmed: bool


def measure(values: Array, estimates: Array, missed: Array | None = None) -> Measured:
    """Return what two or more levels say of a vector on the last one.

    An effectivity from 0.5 to 1.5 confirms the estimate, which is added. One outside, on the same
    side as that of the levels before and of about its size, is confirmed: the measured error is
    added; else the mean of both errors, which differs from the estimate by half of it at most. The
    bounds are what the estimate may miss, at least the difference of estimated and measured error;
    without confirmation nothing says that an error has decreased, and they are the estimate of the
    level before, and by how much values with their estimates have changed.
    What the change of a vector has that is not parallel to that of the estimate decreases as the
    estimate does, and is added to the bounds.

    Parameters
    ----------
    values, estimates : (levels, n) array
        The components and what is to be added to them, from coarse to fine.
    missed : (n,) array, optional
        What the last estimate may miss; default: half of it.
    """
    e, before = estimates[-1], estimates[-2]
    missed = MISSED * np.abs(e) if missed is None else missed
    thetas = [effectivity(values[k:], estimates[k:]) for k in range(len(values) - 1)]
    theta, factor, confirmed = thetas[-1], 1.0, True
    if abs(theta - 1) > MISSED:
        before_it = thetas[-2] if len(thetas) > 1 else 1.0
        confirmed = abs(before_it - 1) > MISSED and (theta > 1) == (before_it > 1)
        confirmed &= abs(theta - before_it) <= MISSED * max(theta, before_it)
        mean = min(max((1 + theta) / 2, 1 - MISSED), 1 + MISSED)
        factor = max(theta, 0.0) if confirmed else mean
    sizes = float(np.abs(e).max()), float(np.abs(before).max())
    confirmed &= sizes[0] <= _SLOWEST * sizes[1]
    bounds = np.maximum(missed, abs(theta - 1) * np.abs(e))
    if not confirmed:
        bounds = np.maximum(bounds, np.abs(values[-1] + e - values[-2] - before) + np.abs(before))
    bounds = np.maximum(bounds, OF_VECTOR * bounds.max(initial=0.0))
    ratio = min(sizes[0] / sizes[1], _SLOWEST) if sizes[1] else _SLOWEST
    rest = float(np.abs(values[-1] - values[-2] - theta * (before - e)).max())
    return Measured(theta, factor, bounds + rest * ratio / (1 - ratio), confirmed)


def effectivity(values: Array, estimates: Array) -> float:
    """Return the measured effectivity of the first two levels; 1 if the estimate is the same."""
    change, predicted = values[1] - values[0], estimates[0] - estimates[1]
    square = float(predicted @ predicted)
    return float(change @ predicted) / square if square else 1.0


def of_order(values: Sequence[Array], powers: Sequence[float]) -> tuple[Array, Array]:
    """Return what is to be added to the last values of a vector, and what that may miss, (n,) each.

    Parameters
    ----------
    values : sequence of (n,) array
        Two or more, of finer and finer levels.
    powers : sequence of float
        By what each refinement divides the error: r^p, one less than the values.
    """
    pairs = zip(pairwise(values), powers, strict=True)
    estimates = np.array([(fine - coarse) / (power - 1) for (coarse, fine), power in pairs])
    if len(estimates) == 1:
        missed = MISSED * np.abs(estimates[0])
        return estimates[0], np.maximum(missed, OF_VECTOR * missed.max(initial=0.0))
    found = measure(np.array(values[1:]), estimates)
    return found.factor * estimates[-1], found.bounds
