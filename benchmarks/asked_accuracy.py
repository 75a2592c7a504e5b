"""Is what was asked for true? Runs to an accuracy of scenes, loads, materials and elements.

Each is compared with a value that is extrapolated from three uniform meshes, as in
`error_estimates`, or is exact (the stretch, the quarter turn, the bracket and Hertz's contact of
`accuracy_cases`).
"""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row, accuracy_cases, error_estimates, split_list
from benchmarks.time_to_accuracy import adaptive
from fem_snh.errors import choose

#: Scenes of `error_estimates`, with the ratio, the element that is asked with, cells and the goal.
_ASKED = (
    ("cook", 0.3, "Q1", 16, "corner.y"),
    ("cook", 0.4999, "P1", 16, "corner.y"),
    ("plane", 0.3, "P1", 8, "tip.x"),
    ("plane", 0.4999, "P1", 8, "corner.y"),
    ("plane", 0.49, "Q1P0", 16, "energy"),
    ("sheet", 0.49, "Q1", 8, "tip.x"),
    ("sheet", 0.3, "P2", 4, "corner.y"),
    ("twist", 0.3, "Q1", 12, "energy"),
    ("twist", 0.49, "Q1P0", 12, "top.force.z"),
    ("twist", 0.4999, "P2P0", 4, "top.force.z"),
    ("shear", 0.3, "P1", 8, "corner.x"),
    ("shear", 0.4999, "Q1", 8, "corner.z"),
    ("block", 0.4999, "Q2", 4, "energy"),
    ("bar", 0.3, "Q1", 4, "end.z"),
    ("tube", 0.4999, "Q1P0", 16, "inner.x"),
    ("rod", 0.49, "Q1", 16, "energy"),
    ("bushing", 0.4999, "Q2Q1", 8, "energy"),
)
#: Cases of `accuracy_cases`.
_EXACT = ("stretch", "quarter turn", "bracket", "hertz")


def rows(
    share: float = 0.01, scenes: str = "", max_time: float = 300.0, exact: bool = True
) -> Iterator[Row]:
    """Yield one row for each scene; then a summary.

    Parameters
    ----------
    share : float
        The accuracy that is asked for.
    scenes : str
        Names of scenes; default: all.
    max_time : float
        Longest run [s].
    exact : bool
        Whether the cases with exact values are run, too.

    Yields
    ------
    dict
        What `time_to_accuracy.adaptive` returns: ``true_error`` of the value that the last level
        reports, ``reached``, whether the run says that it is within the accuracy, and its cost.
    """
    known = list(dict.fromkeys(name for name, *_ in _ASKED))
    chosen = [choose("scenes", name, known) for name in split_list(scenes)] if scenes else known
    found: list[Row] = []
    for name, nu, element, cells, goal in _ASKED:
        if name in chosen:
            scene = error_estimates.scene_of(name, nu, element, cells)
            row = adaptive(scene, goal, share, error_estimates.exact(name, nu)[goal], max_time)
            about = {"scene": name, "nu": nu, "asked_with": element, "goal": goal}
            found.append(_judged(about | row, share))
            yield found[-1]
    for name in _EXACT if exact else ():
        case = accuracy_cases.CASES[name]
        row = adaptive(case.scene(), case.goal, share, accuracy_cases.exact(name)[0], max_time)
        found.append(_judged({"scene": name, "goal": case.goal} | row, share))
        yield found[-1]
    errors = [
        row["true_error"] for row in found if row["reached"] and row["true_error"] is not None
    ]
    yield {
        "summary": len(found),
        "reached": sum(row["reached"] for row in found),
        "compared": len(errors),
        "within": sum(error <= share for error in errors),
        "within_twice": sum(error <= 2 * share for error in errors),
        "largest": max(errors, default=None),
    }


def _judged(row: Row, share: float) -> Row:
    """Return the row with whether the run kept its word, within twice the accuracy."""
    error = row["true_error"]
    return row | {"ok": not row["reached"] or error is None or error <= 2 * share}
