"""Is what was asked for true of random scenes? Each is compared with finer meshes.

Loads, ratios, materials, elements and meshes are drawn at random, in families: `plane`, `solid`,
`revolved`, `contrast`, `supported`, `moving` and `rubbing` of `benchmarks.random_scenes`.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import fem_snh
from benchmarks import Row, split_list
from benchmarks.random_scenes import draw_scenes, goals_of_levels
from fem_snh.problem.goals import vector_of

#: Differences below this part of a value are rounding: prescribed displacements have no error.
_ROUNDING = 1e-12


class _Error(NamedTuple):
    """The true error of a goal, over the largest component of its vector, and over its bound."""

    goal: str
    relative: float
    over: float


def rows(
    families: str = "plane",
    first: int = 0,
    count: int = 20,
    share: float = 0.01,
    finer: float = 20.0,
    max_time: float = 60,
) -> Iterator[Row]:
    """Yield one row for each scene; then a summary.

    Parameters
    ----------
    families : str
        plane: brackets and Cook's membrane in plane strain and plane stress; solid: brackets, cubes
        and cylinders in three dimensions; revolved: tubes, rods and bushings as bodies of
        revolution, most under a follower pressure; contrast: bars of two materials, one up to 1000
        times as stiff; supported: cubes with weight, on foundations, between symmetry planes,
        pressed by a plane or a sphere; moving: bodies in time, held, on springs, shaken or thrown
        at a plane, with rigid parts and loads that change; rubbing: cubes and cylinders that planes
        and spheres press and rub, with friction.
    first, count : int
        The first seed, and the number of scenes of each family.
    share : float
        The accuracy that is asked for.
    finer : float
        The values that are compared with are those of runs to this part of it.
    max_time : float
        Longest run [s].

    Yields
    ------
    dict
        The scene; ``goals``, how many are within the accuracy according to the run and known, from
        the finer one, better by half of ``finer``; ``largest``, their largest true error, relative
        to the largest component of the same vector; ``within``, how many are within their own
        bounds, as far as the finer run knows; ``beyond``, the others with their errors over the
        bound; ``failed``, what ended a run.
    """
    found: list[_Error] = []
    scenes = 0
    for about, scene, goals in draw_scenes(families, first, count):
        try:
            coarse, fine = (
                goals_of_levels(scene, goals, within, max_time)[-1]
                for within in (share, share / finer)
            )
        except fem_snh.BadInput as reason:
            yield about | {"failed": str(reason), "ok": False}
            continue
        errors = _errors(coarse, fine, share, 2 / finer)
        found += errors
        scenes += bool(errors)
        yield about | _summary(errors, share)
    yield {"summary": count * len(split_list(families)), "compared": scenes} | _summary(
        found, share
    )


def _errors(
    coarse: dict[str, Any], fine: dict[str, Any], share: float, known: float
) -> list[_Error]:
    """Return the true errors of goals that are within a share, and known to a part of the bound."""
    sizes: dict[str, float] = {}
    for name, goal in fine.items():
        sizes[vector_of(name)] = max(sizes.get(vector_of(name), 0.0), abs(goal["corrected"]))
    errors = []
    for name, goal in coarse.items():
        exact = fine.get(name)
        if not exact or None in (goal["bound"], exact["bound"]) or goal["within"] > share:
            continue
        left, size = exact["bound"], sizes[vector_of(name)]
        if left > known * goal["bound"] or not size:
            continue
        error = max(abs(goal["corrected"] - exact["corrected"]) - _ROUNDING * size, 0.0)
        errors.append(_Error(name, error / size, (error - left) / goal["bound"]))
    return errors


def _summary(errors: list[_Error], share: float) -> Row:
    largest = max((error.relative for error in errors), default=None)
    beyond = {error.goal: round(error.over, 2) for error in errors if error.over > 1}
    return {
        "goals": len(errors),
        "largest": largest,
        "within": sum(error.over <= 1 for error in errors),
        "beyond": beyond,
        "ok": largest is None or largest <= share,
    }
