"""Is what was asked for true? Runs to an accuracy of scenes, loads, materials and elements.

Each of the scenes of `asked_cases` is compared with a value that no estimate is part of: exact,
published, or extrapolated from uniform or graded meshes (`exact_goals`, with its uncertainty).
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import fem_snh
from benchmarks import Row
from benchmarks.asked_cases import CASES, truth
from fem_snh.errors import choose

#: Of all scenes, how many may be beyond the bound that their run states, and how many may not be
#: within what was asked for, or state nothing.
_BEYOND, _WRONG, _SILENT = 3, 1, 4


def rows(share: float = 0.01, scenes: str = "", max_time: float = 120.0) -> Iterator[Row]:
    """Yield one row for each scene; then a summary.

    Parameters
    ----------
    share : float
        The accuracy that is asked for.
    scenes : str
        Names of scenes, separated by semicolons as they have commas; default: all.
    max_time : float
        No level is begun that ends later [s].

    Yields
    ------
    dict
        ``bound``, ``true_error`` of the corrected value on the last level with a bound, and the
        ``uncertainty`` of the reference, over the size of the goal's vector; ``within_bound`` and
        ``within_twice``: whether the error less this uncertainty is within the bound and within
        twice the bound; ``within_asked``: whether it is within ``share``; ``theta``, ``confirmed``:
        the effectivity; ``reached``: whether the run says that it is within ``share``, else
        ``reason``.
    """
    chosen = [name.strip() for name in scenes.split(";") if name.strip()] or list(CASES)
    found: list[Row] = []
    for name in chosen:
        found.append(_row(choose("scenes", name, CASES), share, max_time))
        yield found[-1]
    yield _summary(found)


def _row(name: str, share: float, max_time: float) -> Row:
    """Return the row of a scene."""
    case, clock = CASES[name], perf_counter()
    accuracy = {"goals": [case.goal], "within": share, "max_time": max_time}
    with TemporaryDirectory() as folder:
        scene = case.build(Path(folder))
        record = fem_snh.run(scene, accuracy=accuracy, progress=False).record["accuracy"]
    levels = record["levels"]
    row: Row = {"scene": name, "goal": case.goal, "asked_with": scene.element}
    row |= {"reached": bool(record["reached"]), "levels": len(levels)}
    row |= {key: levels[-1][key] for key in ("element", "cells", "dofs")}
    row["seconds"] = round(perf_counter() - clock, 1)
    if not row["reached"]:
        row["reason"] = levels[-1]["reason"] or record["limit"]
    goals = [level["goals"].get(case.goal, {}) for level in levels]
    goal = next((goal for goal in reversed(goals) if goal.get("bound")), None)
    if goal is None:
        return row | {"ok": True}
    value, uncertainty = truth(name)
    scale = goal["bound"] / goal["within"]
    bound, error, known = (
        x / scale for x in (goal["bound"], abs(goal["corrected"] - value), uncertainty)
    )
    row |= {"bound": bound, "true_error": error, "uncertainty": known}
    row |= {key: goal[key] for key in ("theta", "confirmed")}
    least = error - known
    row |= {"within_bound": least <= bound, "within_twice": least <= 2 * bound}
    return row | {"within_asked": least <= share, "ok": least <= 2 * bound}


def _summary(rows: list[Row]) -> Row:
    """Return the counts of all scenes."""
    stated = [row for row in rows if "bound" in row]
    counts: Row = {"summary": len(rows), "reached": sum(row["reached"] for row in rows)}
    counts |= {"silent": counts["summary"] - counts["reached"], "bounds": len(stated)}
    for key in ("within_bound", "within_twice", "within_asked"):
        counts[key] = sum(row[key] for row in stated)
    reached = [row for row in stated if row["reached"]]
    counts["wrong"] = sum(not row["within_asked"] for row in reached)
    counts["largest"] = max((row["true_error"] for row in reached), default=None)
    counts["seconds"] = round(sum(row["seconds"] for row in rows), 1)
    counts["ok"] = bool(
        counts["within_bound"] >= counts["bounds"] - _BEYOND
        and counts["within_twice"] == counts["bounds"]
        and counts["wrong"] <= _WRONG
        and counts["silent"] <= _SILENT
    )
    return counts
