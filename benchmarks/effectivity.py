"""Do bounds hold on each level, and how far from 1 are effectivities? Random scenes tell.

The values and the estimates of all levels of a run are compared with those of its last level, where
that is known ten times better (`fem_snh.accuracy.effectivity`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

import fem_snh
from benchmarks import Row
from benchmarks.random_scenes import draw_scenes, goals_of_levels
from fem_snh.accuracy.effectivity import effectivity
from fem_snh.problem.goals import vector_of

#: Levels are compared whose error is so many times what the last level may miss; and is this
#: part of the value.
_KNOWN, _LEAST = 10.0, 1e-5


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
        the estimate; ``over``, the largest true error of a component over its bound, less the bound
        of the last level; ``bound`` and ``error``, the largest ones over the largest component;
        ``confirmed``, whether the effectivity confirms the estimate.
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
    for vector in dict.fromkeys(map(vector_of, levels[-1])) if len(levels) > 2 else ():
        names = [name for name in levels[-1] if vector_of(name) == vector]
        of_vector = [goals for goals in levels if set(names) <= set(goals)]
        values, corrected, bounds = (
            np.array([[goals[name][key] or 0.0 for name in names] for goals in of_vector])
            for key in ("value", "corrected", "bound")
        )
        true, left = corrected[-1], bounds[-1]
        scale = np.abs(true).max()
        for k in range(1, len(of_vector) - 1):
            goal, error = of_vector[k][names[0]], np.abs(corrected[k] - true)
            largest = np.abs(values[k] - true).max()
            if largest <= max(_KNOWN * left.max(), _LEAST * scale) or not bounds[k].all():
                continue
            mesh = np.array([_of_mesh(of_vector[k][name]) for name in names])
            estimates = mesh / goal["factor"] if goal["factor"] else 0 * true
            exact = np.array([corrected[k] - mesh, true]), np.array([estimates, 0 * true])
            yield {
                "goal": vector,
                "level": k + 1,
                "theta": goal["theta"],
                "effectivity": effectivity(*exact),
                "over": float(((error - left) / bounds[k]).max()),
                "bound": float(bounds[k].max() / scale),
                "error": float(error.max() / scale),
                "confirmed": goal["confirmed"],
            }


def _of_mesh(goal: Mapping[str, Any]) -> float:
    """Return the part of the mesh in an error."""
    return float(goal["parts"].get("mesh", 0.0) if "parts" in goal else goal["error"])


def _summary(found: Sequence[Row]) -> Row:
    """Return how many vectors are beyond their bounds, and the medians of the bounds."""
    row: Row = {"summary": len(found)}
    for name, rows_ in (("all", found), ("confirmed", [r for r in found if r["confirmed"]])):
        over = np.array([entry["over"] for entry in rows_])
        row[name] = {
            "vectors": len(rows_),
            "beyond": int((over > 1).sum()),
            "beyond_twice": int((over > 2).sum()),
            "worst": float(over.max(initial=0.0)),
            "median_bound": float(np.median([r["bound"] for r in rows_])) if rows_ else None,
            "median_error": float(np.median([r["error"] for r in rows_])) if rows_ else None,
        }
    return row
