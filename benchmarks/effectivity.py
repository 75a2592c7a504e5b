"""Which bounds would two levels measure? The change of a value over the change of its estimate.

With the value v and the estimate e of a goal on two levels, the measured effectivity is

    theta = (v_k - v_(k-1)) . (e_(k-1) - e_k) / |e_(k-1) - e_k|^2,

with the components of a vector together. If all levels miss the same part, v + theta e is exact.
The rule that is compared with today's bounds has three constants: `_SATURATION`, `_OF_VECTOR` and
`_SLOWEST`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

import fem_snh
from benchmarks import Row
from benchmarks.random_scenes import draw_scenes, goals_of_levels
from fem_snh.accuracy.goals import vector_of

Array = npt.NDArray[np.float64]

#: The better element is taken to have at most a third of the error of the run's: then the error is
#: 0.75 to 1.5 times the estimate, and half of the estimate bounds what it misses.
_SATURATION = 1 / 3
#: Least bound of a component over the largest estimate of its vector, in the units of that bound:
#: the estimate of a component that changes its sign is small by chance.
_OF_VECTOR = 0.2
#: Largest ratio of two estimates with which a change that they do not explain is extrapolated.
_SLOWEST = 0.8
#: Levels are compared whose estimate is so many times what the last level may miss; and is this
#: part of the value.
_KNOWN, _LEAST = 10.0, 1e-5


class Measured(NamedTuple):
    """The effectivity of a vector's estimate, its corrected components and their bounds."""

    theta: float
    corrected: Array
    bounds: Array


def measured(values: Array, errors: Array) -> Measured:
    """Return what two or three levels say of a vector on the last one.

    An effectivity from 0.5 to 1.5 confirms the estimate. If one is outside, the middle of both is
    taken; if the two last ones are, on the same side, the measured one. Both bounds are the
    difference of measured and estimated error. What the change of a vector has that is not
    parallel to that of the estimate decreases as the estimate does, and is added.

    Parameters
    ----------
    values, errors : (levels, n) array
        The components, and what their estimates add to them, from coarse to fine.
    """
    missed = _SATURATION / (1 - _SATURATION)
    thetas = [effectivity(values[k - 1 :], errors[k - 1 :]) for k in range(1, len(values))]
    theta, factor = thetas[-1], 1.0
    if abs(theta - 1) > missed:
        again = len(thetas) > 1 and abs(thetas[-2] - 1) > missed
        confirmed = again and (theta > 1) == (thetas[-2] > 1)
        factor, missed = theta if confirmed else (1 + theta) / 2, abs(theta - 1)
    sizes = np.abs(errors[-1])
    largest, largest_before = sizes.max(), np.abs(errors[-2]).max()
    ratio = min(largest / largest_before, _SLOWEST) if largest_before else 0.0
    rest = values[-1] - values[-2] - theta * (errors[-2] - errors[-1])
    bounds = missed * np.maximum(sizes, _OF_VECTOR * largest)
    bounds += np.abs(rest).max() * ratio / (1 - ratio)
    return Measured(theta, values[-1] + factor * errors[-1], bounds)


def effectivity(values: Array, errors: Array) -> float:
    """Return the measured effectivity of the first two levels; 1 if the estimate is the same."""
    change, predicted = values[1] - values[0], errors[0] - errors[1]
    square = float(predicted @ predicted)
    return float(change @ predicted) / square if square else 1.0


def rows(
    families: str = "plane,contrast,revolved,solid,supported",
    first: int = 0,
    count: int = 10,
    within: float = 3e-5,
    max_time: float = 15.0,
) -> Iterator[Row]:
    """Yield one row for each vector and level of random scenes; then a summary.

    Parameters
    ----------
    families : str
        Families of `benchmarks.random_scenes`.
    first, count : int
        The first seed, and the number of scenes of each family.
    within : float
        The accuracy of the last level, whose corrected values are taken for exact ones.
    max_time : float
        Longest run [s].

    Yields
    ------
    dict
        ``theta``, measured by this level and the one before; ``effectivity``, the true error over
        the estimate; for both rules ``over``, the largest true error of a component over its bound,
        less the bound of the last level, and ``bound``, the largest bound over the largest
        component.
    """
    found: list[Row] = []
    for about, scene, goals in draw_scenes(families, first, count):
        try:
            levels = goals_of_levels(scene, goals, within, max_time)
        except fem_snh.BadInput as reason:
            yield about | {"failed": str(reason)}
            continue
        for row in compared([known for known in levels if known]):
            found.append(about | row)
            yield found[-1]
    yield _summary(found)


def compared(levels: Sequence[Mapping[str, Any]]) -> Iterator[Row]:
    """Yield the rows of a run, from the goals of its levels as run.json has them."""
    if len(levels) < 3:
        return
    for vector in dict.fromkeys(map(vector_of, levels[-1])):
        names = [name for name in levels[-1] if vector_of(name) == vector]
        of_vector = [goals for goals in levels if set(names) <= set(goals)]
        values, errors, bounds = (
            np.array([[goals[name][key] or 0.0 for name in names] for goals in of_vector])
            for key in ("value", "error", "uncertainty")
        )
        true = values[-1] + errors[-1]
        scale, left = np.abs(true).max(), bounds[-1]
        for k in range(1, len(of_vector) - 1):
            largest = np.abs(errors[k]).max()
            if largest <= max(_KNOWN * left.max(), _LEAST * scale):
                continue
            here = measured(*(levels[max(k - 2, 0) : k + 1] for levels in (values, errors)))
            exact = np.array([values[k], true]), np.array([errors[k], np.zeros_like(true)])
            rules = {"today": (values[k] + errors[k], bounds[k]), "measured": here[1:]}
            row: Row = {"goal": vector, "level": k + 1, "estimate": float(largest / scale)}
            row |= {"theta": here.theta, "effectivity": effectivity(*exact)}
            for rule, (corrected, bound) in rules.items():
                over = ((np.abs(corrected - true) - left) / bound).max()
                row[rule] = {"over": float(over), "bound": float(bound.max() / scale)}
            yield row


def _summary(found: Sequence[Row]) -> Row:
    """Return how many vectors are beyond their bounds, and the medians of the bounds."""
    row: Row = {"summary": len(found)}
    for rule in ("today", "measured"):
        over = np.array([entry[rule]["over"] for entry in found])
        bounds = [entry[rule]["bound"] for entry in found]
        row[rule] = {
            "beyond": int((over > 1).sum()),
            "beyond_twice": int((over > 2).sum()),
            "worst": float(over.max(initial=0.0)),
            "median_bound": float(np.median(bounds)) if bounds else None,
        }
    return row
