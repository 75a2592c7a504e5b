r"""Volumes of the next mesh's cells, from the errors in those of the last and their measured rates.

A cell that is divided into n keeps :math:`\eta\, n^{-s/d}` of its error :math:`\eta`, with the rate
s in the size of cells and the dimension d: 2p where the solution is smooth, as a goal's error is a
product of two errors of order p. Where two levels are known, each cell's rate is measured: by the
errors of the parts of a cell beside that of the cell. Of all meshes of as many cells, the sum of
the errors is least with

.. math:: n = ((s/d)\, \eta/\mu)^{d/(s + d)},

and a multiplier :math:`\mu`. In two dimensions a cell that has a singular point, where
the rate is below p, has sizes that grow from that point on: n is its area over that of the smallest
part, and each of the :math:`\log_2 n` bisections there costs c cells. Then the least sum has
:math:`n = (\ln 2\, (s/d)\, \eta/(c\mu))^{d/s}`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import log
from typing import NamedTuple

import numpy as np

from fem_snh.accuracy.effectivity import MISSED
from fem_snh.arrays import Array

#: Cells that a bisection of those at a vertex adds, where sizes grow by about a = 0.35 of the
#: distance (`fem_snh.mesh.bisection`): pi log(2) / (a^2 sqrt(3)/4).
_CELLS_OF_BISECTION = 41.0
#: Parts into which the edges of a cell are divided at most, with an assumed and a measured rate.
_MOST_PARTS, _MOST_MEASURED = 4.0, 32.0
#: Least rate that is believed: that of cross-points of a contrast of 600.
_LEAST_RATE = 0.1


class Lineage(NamedTuple):
    """Where the cells of a refined mesh come from.

    Attributes
    ----------
    parents : (cells,) int array
        The cell of the mesh before of which each is a part.
    errors, rates : (parents,) array
        The sums of the errors of the goals in those, and the rates that were taken for them.
    of_goals : mapping of (parents,) array
        The sizes of the errors of each goal in them.
    """

    parents: Array
    errors: Array
    rates: Array
    of_goals: Mapping[str, Array] = {}


def measured_rates(errors: Array, lineage: Lineage | None, degree: int, dim: int) -> Array:
    """Return the rate of each cell's error in its size, (cells,).

    Parameters
    ----------
    errors : (cells,) array
        The sizes of the errors of the cells.
    lineage : Lineage or None
        Where the cells come from; None on a first mesh, whose rates are those of smooth solutions.
    degree, dim : int
        The degree of the displacement, and the dimension of the mesh.
    """
    smooth = 2.0 * degree
    if lineage is None:
        return np.full(len(errors), smooth)
    count = len(lineage.errors)
    parts = np.bincount(lineage.parents, minlength=count)
    left = np.bincount(lineage.parents, errors, minlength=count)
    known = (parts > 1) & (left > 0) & (lineage.errors > 0)
    rates = lineage.rates.copy()
    rates[known] = -np.log(left[known] / lineage.errors[known]) / np.log(parts[known]) * dim
    return np.asarray(np.clip(rates, _LEAST_RATE, smooth)[lineage.parents])


def left_by_parts(lineage: Lineage, degree: int, dim: int) -> float:
    """Return the part of the errors that divided cells leave where the solution is smooth."""
    parts = np.bincount(lineage.parents, minlength=len(lineage.errors))
    total = float(lineage.errors.sum())
    left = float((lineage.errors * parts ** (-2.0 * degree / dim)).sum())
    return left / total if total > 0 else 1.0


def left_by_uniform(before: int, dofs: int, degree: int, dim: int) -> float:
    """Return the same of cells of one size, from the unknowns of both meshes."""
    return float(min(before / dofs, 1.0) ** (2.0 * degree / dim))


def unmeasured(errors: Array, error: float, parents: Array, before: Array) -> float:
    """Return a goal's errors on the mesh before of which an effectivity says nothing.

    The cells with the largest errors have half of their sum. The change between the two meshes was
    elsewhere if less than half of their share of it, a quarter, was there: then it is what the mesh
    before had there; else 0. It is 0, too, where the sum is more than twice the error: errors that
    cancel do not tell where it is.

    Parameters
    ----------
    errors : (cells,) array
        The sizes of the goal's errors in the cells.
    error : float
        The size of its error.
    parents : (cells,) array
        The cell of the mesh before of which each is a part.
    before : (parents,) array
        The sizes of its errors in those.
    """
    if not 0 < errors.sum() * MISSED <= error:
        return 0.0
    order = np.argsort(errors)[::-1]
    half = int(np.searchsorted(np.cumsum(errors[order]), errors.sum() / 2)) + 1
    there = np.zeros(len(before), dtype=bool)
    there[parents[order[:half]]] = True
    left = before[there].sum() - errors[there[parents]].sum()
    measured = left >= MISSED**2 * (before.sum() - errors.sum())
    return 0.0 if measured else float(before[there].sum())


def target_volumes(
    volumes: Array,
    errors: Array,
    rates: Array,
    degree: int,
    dim: int,
    wanted: float,
    expected: Callable[[Array], float],
    left: float = 0.0,
) -> Array:
    """Return the volumes of cells with which an error needs the fewest of them.

    Parameters
    ----------
    volumes, errors, rates : (cells,) array
        The volumes [length^dim], the sizes of the errors of the cells, and their rates.
    degree, dim : int
        The degree of the displacement, and the dimension of the mesh.
    wanted : float
        The number of cells of the new mesh.
    expected : callable
        Returns the number of cells that a mesh with wanted volumes (cells,) has.
    left : float, optional
        The part of the errors that may be left: fewer cells than wanted suffice for it. Errors
        left in cells that are divided as often as one level may do not count.
    """
    if not errors.sum() > 0:
        return np.asarray(volumes * len(volumes) / wanted)
    singular = (rates < degree) & (dim == 2)
    weights = np.where(singular, log(2) / _CELLS_OF_BISECTION, 1.0) * rates / dim * errors
    powers = np.where(singular, dim / rates, dim / (rates + dim))
    most = np.where(rates < 2 * degree, _MOST_MEASURED, _MOST_PARTS) ** dim
    sized = np.log(np.maximum(weights, np.finfo(float).tiny))

    def divided(log_mu: float) -> Array:
        return np.asarray(np.exp(np.clip(powers * (sized - log_mu), 0.0, np.log(most))))

    def suffices(parts: Array) -> bool:
        remain = np.where(parts < most, errors * parts ** (-rates / dim), 0.0)
        enough = expected(volumes / parts) >= wanted
        return enough or float(remain.sum()) <= left * float(errors.sum())

    low, high = (sized - np.log(most) / powers).min(), sized.max()
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if suffices(divided(middle)) else (low, middle)
    return np.asarray(volumes / divided((low + high) / 2))
