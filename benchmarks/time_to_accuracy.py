"""Seconds to an accuracy: adaptive, the best uniform mesh by hindsight, and dolfinx's tutorial.

``adaptive``: ``--accuracy``, from its coarse mesh on, with all of its levels and estimates.
``uniform``: every element on every mesh of a ladder; the cheapest run within the accuracy of the
exact value, which nobody knows beforehand. ``tutorial``: dolfinx's Newton method with MUMPS on
uniform P2, likewise, its load steps alone; three dimensions only.
"""

from __future__ import annotations

from collections.abc import Iterator
from math import isnan
from time import perf_counter, process_time

import fem_snh
from benchmarks import Row, fenicsx_tutorial, split_list
from benchmarks.accuracy_cases import CASES, Case, exact, goals_of
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.errors import BadInput, choose
from fem_snh.scenes import Scene

#: Elements that run on uniform meshes; hexahedra are left out where a geometry has none.
ELEMENTS_TRIED = "Q1P0,Q2,Q2Q1,P2,P2P0"
#: Longest adaptive run [s].
SECONDS = 300.0
#: A mesh that takes longer than this ends the ladder of its element [s].
TIMEOUT = 60.0


def rows(
    cases: str = "",
    shares: str = "0.05,0.01,0.001",
    elements: str = ELEMENTS_TRIED,
    ways: str = "uniform,adaptive,tutorial",
    start: str = "",
    timeout: float = TIMEOUT,
) -> Iterator[Row]:
    """Yield one row for each case and accuracy.

    Parameters
    ----------
    cases : str
        Names of cases, separated by semicolons; default: all.
    shares : str
        Accuracies, as fractions.
    elements : str
        Elements of uniform meshes.
    ways : str
        Of uniform, adaptive, tutorial.
    start : str
        Element that adaptive runs begin with; default: that of the scene.
    timeout : float
        A uniform mesh that takes longer is the last of its element [s].

    Yields
    ------
    dict
        Processor seconds of each way (one rank) without compilation, None if it does not reach
        the accuracy; ``true_error``: of the adaptive run's best value.
    """
    chosen, options = split_list(ways), {"element": start} if start else {}
    for name in [word.strip() for word in cases.split(";") if word.strip()] or list(CASES):
        case = CASES[choose("cases", name, CASES)]
        tried = _uniform(name, case, split_list(elements), timeout) if "uniform" in chosen else []
        others = _tutorial(name, case, timeout) if "tutorial" in chosen else []
        if "adaptive" in chosen:
            adaptive(case.scene(**options), case.goal, 0.2, exact(name)[0])  # compiles the kernels
        for share in map(float, split_list(shares)):
            row: Row = {"case": name, "goal": case.goal, "share": share}
            row["uniform"] = best = _cheapest(tried, share)
            row["tutorial"] = tutorial = _cheapest(others, share)
            if "adaptive" in chosen:
                row |= adaptive(case.scene(**options), case.goal, share, exact(name)[0])
                row |= _judged(row, share, best, tutorial)
            yield row


def adaptive(scene: Scene, goal: str, share: float, true: float, max_time: float = SECONDS) -> Row:
    """Return the cost and the true error of a run to an accuracy."""
    accuracy = {"goals": [goal], "within": share, "max_time": max_time}
    clock, working = perf_counter(), process_time()
    found = fem_snh.run(scene, accuracy=accuracy, progress=False).record["accuracy"]
    seconds, elapsed = process_time() - working, perf_counter() - clock
    last = found["levels"][-1]
    row: Row = {
        "adaptive": round(seconds, 3),
        "elapsed": round(elapsed, 3),
        "levels": len(found["levels"]),
        "element": last["element"],
        "cells": last["cells"],
        "dofs": last["dofs"],
        "reached": bool(found["reached"]),
        "bound": found["relative"],
    }
    if goal not in last["goals"] or isnan(true):
        return row | {"true_error": None, "reason": last["reason"]}
    return row | {"true_error": abs(last["goals"][goal]["corrected"] / true - 1)}


def _uniform(name: str, case: Case, elements: list[str], timeout: float) -> list[Row]:
    """Return a row for each element and mesh, from coarse to fine."""
    found = []
    for element in elements:
        degree = ELEMENTS[choose("elements", element, ELEMENTS)].degree
        for number, cells in enumerate(sorted({max(n // degree, 1) for n in case.ladder})):
            try:
                if number == 0:
                    _solved(case, element, cells)  # compiles the kernels
                row = _solved(case, element, cells)
            except BadInput:  # too few cells for a geometry, or no hexahedra
                continue
            if row["value"] is None:
                continue
            found.append(row | {"error": abs(row["value"] / exact(name)[0] - 1)})
            if row["seconds"] > timeout:
                break
    return found


def _solved(case: Case, element: str, cells: int) -> Row:
    """Return the processor seconds of a run, and the goal's value; None if it did not converge."""
    working = process_time()
    result = fem_snh.run(case.scene(element=element, cells=cells), progress=False)
    seconds = process_time() - working
    value = goals_of(result.steps[-1])[case.goal] if result.converged else None
    return {"element": element, "cells": cells, "seconds": seconds, "value": value}


def _tutorial(name: str, case: Case, timeout: float) -> list[Row]:
    """Return a row for each mesh that the tutorial's program solves."""
    found = []
    for cells in sorted({max(n // 2, 1) for n in case.ladder}):
        scene = case.scene(element="P2", cells=cells)
        if scene.obstacle or scene.bone:
            return []
        try:
            record = fenicsx_tutorial.solve(scene, goal=case.goal)
        except BadInput:
            continue
        seconds = sum(step["processor_seconds"] for step in record["steps"])
        if record["converged"]:
            error = abs(record["goal"] / exact(name)[0] - 1)
            found.append({"element": "P2", "cells": cells, "seconds": seconds, "error": error})
        if seconds > timeout:
            break
    return found


def _cheapest(tried: list[Row], share: float) -> Row | None:
    """Return element, cells and seconds of the cheapest run within an accuracy."""
    within = [row for row in tried if row["error"] <= share]
    if not within:
        return None
    row = min(within, key=lambda row: row["seconds"])
    return {key: row[key] for key in ("element", "cells")} | {"seconds": round(row["seconds"], 3)}


def _judged(row: Row, share: float, best: Row | None, tutorial: Row | None) -> Row:
    """Return whether the run kept its word, and the ratios of the seconds."""
    right = bool(row["reached"] and row["true_error"] is not None and row["true_error"] <= share)
    found: Row = {"right": right}
    if best:
        found["over_uniform"] = round(row["adaptive"] / best["seconds"], 2)
    if tutorial:
        found["tutorial_over"] = round(tutorial["seconds"] / row["adaptive"], 1)
    return found
