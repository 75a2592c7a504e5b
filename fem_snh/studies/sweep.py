"""Run a scene for every combination of some values, one row per point.

    >>> table = sweep("twist", "out/nu", {"nu": [0.3, 0.45, 0.49], "cells": 6}, jobs=2)

The folder holds sweep.json (the definition), sweep.csv (a row is appended when a point ends),
sweep.png, on request bodies.png, and one folder per point with its run and its log. An interrupted
sweep continues when it is called again. Points run one after another in the same ``jobs``
processes, which spares each the imports and the start of MPI; a point that fails ends its process.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.materials import function
from fem_snh.materials.parameters import variants
from fem_snh.scenes import MaterialChoice
from fem_snh.studies.batch import Batch
from fem_snh.studies.point import Limits
from fem_snh.studies.scene_points import ScenePoint, file_digests, scene_files, value_text
from fem_snh.studies.schedulers import Submission
from fem_snh.studies.table import ERROR, MEASURED, REQUESTED

if TYPE_CHECKING:
    import pandas as pd


def sweep(
    scene: str | Path,
    out: str | Path,
    axes: Mapping[str, Any],
    *,
    jobs: int | Submission = 1,
    ranks: int = 1,
    timeout: float | None = None,
    memory: float | None = None,
    retry: bool = False,
    overwrite: bool = False,
    petsc: Mapping[str, Any] | None = None,
    render: str | None = None,
    report: Callable[[str], None] = print,
) -> pd.DataFrame:
    """Run every combination of ``axes`` and return the table, sweep.csv.

    A point that fails (does not converge, crashes, takes too long) is a row with its reason; the
    others continue.

    Parameters
    ----------
    scene : str | Path
        A name or a .toml file.
    out : str | Path
        The folder; a sweep that it holds is continued.
    axes : mapping
        A list of values (or one value) for each key of `fem_snh.scenes.load`.
    jobs : int or Submission
        Points at a time on this machine; or how they are submitted to a scheduler. Then the call
        returns at once, and the same call again adds the rows of those that have ended.
    ranks : int
        MPI ranks of each point.
    timeout : float, optional
        Seconds after which a point is given up.
    memory : float, optional
        Resident memory above which a point is given up [GiB].
    retry : bool
        Run again the points of earlier calls that failed.
    overwrite : bool
        Delete an earlier sweep in ``out``.
    petsc : mapping, optional
        PETSc options of every point, without the dash.
    render : str, optional
        Draw the bodies of all points at their last loads in one picture, bodies.png; its colours
        show this field, e.g. "J".
    report : callable
        Called with one line per point.

    Returns
    -------
    pandas.DataFrame
        One row per point. With the key ``error`` of a scene it has a column ``error``, the
        largest relative error of the point's goals as the estimate finds it.

    Raises
    ------
    BadInput
        Before anything runs: for a bad value, or if ``out`` holds another sweep.
    """
    limits = Limits(jobs, ranks, timeout, memory)
    lists = {key: list(v) if isinstance(v, list | tuple) else [v] for key, v in axes.items()}
    for key, values in lists.items():
        if any(callable(v) for v in values):  # the points are in other processes
            raise BadInput(f"{key}: expected names or references FILE.py:FUNCTION, no functions")
    options = dict(petsc or {})
    points = {
        name: ScenePoint(scene, values, scenes.load(scene, **values), options)
        for name, values in combinations(lists).items()
    }
    points |= _with_one_variant(points, report)
    files = file_digests(scene, (point.scene for point in points.values()))
    keys = dict.fromkeys(key for point in points.values() for key in point.values)
    extra = [key for key in keys if key not in (*REQUESTED, *MEASURED, ERROR)]
    estimated = any(point.scene.estimates_error for point in points.values())
    batch = Batch(
        out,
        "sweep",
        {"scene": str(scene), "axes": lists, "files": files, "petsc": options},
        ["point", *REQUESTED, *extra, "ranks", *MEASURED, *([ERROR] if estimated else [])],
        limits,
        inputs=scene_files(scene, (point.scene for point in points.values())),
        retry=retry,
        overwrite=overwrite,
        report=report,
    )
    with batch:
        complete = batch.run(points)
        if complete:
            batch.draw()
        if complete and render is not None:
            report(_draw_bodies(batch.out, list(points), render))
    import pandas as pd

    return pd.read_csv(batch.table.path)


def _with_one_variant(
    points: Mapping[str, ScenePoint], report: Callable[[str], None]
) -> dict[str, ScenePoint]:
    """Return the points that `one_variant` changes, with its parameters."""
    keys = one_variant([point.scene for point in points.values()], report)
    changed = {}
    for name, point in points.items():
        if more := keys(point.scene):
            values = {**point.values, **more}
            loaded = scenes.load(point.name, **values)
            changed[name] = replace(point, values=values, scene=loaded)
    return changed


def one_variant(
    loaded: Iterable[scenes.Scene], report: Callable[[str], None]
) -> Callable[[scenes.Scene], dict[str, Any]]:
    """Return a function that gives the keys of a scene whose materials keep one equation at all nu.

    Of materials whose equation would change with nu it is that of the largest; otherwise a curve
    over nu would have a jump.
    """
    at_ratios: dict[tuple[int, str], dict[float, MaterialChoice]] = {}
    for scene in loaded:
        for place, material in enumerate(scene.materials):
            at_ratios.setdefault((place, material.label), {})[material.nu] = material
    kept: dict[tuple[int, str], dict[str, Any]] = {}
    for which, found in at_ratios.items():
        if len(found) > 1:
            defaults = [material.default_variants() for _, material in sorted(found.items())]
            kept[which] = {
                k: v for k, v in defaults[-1].items() if any(d.get(k, v) != v for d in defaults)
            }
    for (_, name), values in kept.items():
        for key, value in values.items():
            equation = variants(function(name))[key].equations[value]
            report(
                f"material.{key} = {value_text(value)} at all nu: {name} has {equation}, its "
                f"default at the largest; --set material.{key} sets another"
            )

    def keys(scene: scenes.Scene) -> dict[str, Any]:
        several = len(scene.materials) > 1
        return {
            f"material.{f'{place}.' if several else ''}{key}": value
            for place, material in enumerate(scene.materials)
            for key, value in kept.get((place, material.label), {}).items()
            if material.parameters.get(key) is None
        }

    return keys


def _draw_bodies(out: Path, points: list[str], field: str) -> str:
    """Draw bodies.png; return its path, or why there is none. A failure is no exception."""
    from fem_snh.viewing.render import compare

    drawn = [name for name in points if (out / name / "fields.pvd").exists()]
    labels = [name.replace("__", ", ").replace("=", " = ") for name in drawn]
    try:
        folders = [out / name for name in drawn]
        return str(compare(folders, out / "bodies.png", labels=labels, field=field))
    except BadInput as error:
        return f"no picture of the bodies: {error}"


def combinations(lists: Mapping[str, list[Any]]) -> dict[str, dict[str, Any]]:
    """Return the values of every point by its name, which contains the values that differ."""
    points: dict[str, dict[str, Any]] = {}
    for chosen in itertools.product(*lists.values()):
        values = dict(zip(lists, chosen, strict=True))
        parts = [f"{key}={value_text(v)}" for key, v in values.items() if len(lists[key]) > 1]
        name = plain = folder_name(parts) or "point"
        for number in itertools.count(2):  # other values can have the same name: "a b", "a_b"
            if points.setdefault(name, values) == values:
                break
            name = f"{plain}-{number}"
    return points


def folder_name(parts: list[str]) -> str:
    """Return texts joined to one name that every file system accepts."""
    return re.sub(r"[^\w.=+-]+", "_", "__".join(parts))
