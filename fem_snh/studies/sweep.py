"""Run a scene for every combination of some values, one row per point.

    >>> table = sweep("twist", "out/nu", {"nu": [0.3, 0.45, 0.49], "cells": 6}, jobs=2)

The folder holds sweep.json (the definition), sweep.csv (with the points that have ended),
sweep.png, on request bodies.png, and one folder per point with its run and its log. An interrupted
sweep continues when it is called again. Each point is a process of its own.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.files import file_digest
from fem_snh.materials import function
from fem_snh.materials.parameters import variants
from fem_snh.scenes import MaterialChoice
from fem_snh.studies.batch import Batch
from fem_snh.studies.points import ERROR, MEASURED, REQUESTED, Limits, Point, value_text
from fem_snh.studies.slurm import Slurm


def sweep(
    scene: str | Path,
    out: str | Path,
    axes: Mapping[str, Any],
    *,
    jobs: int | Slurm = 1,
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
    jobs : int or Slurm
        Points at a time on this machine; or how they are submitted to Slurm. Then the call
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
        name: Point(scene, values, scenes.load(scene, **values), options)
        for name, values in combinations(lists).items()
    }
    points = _keep_equations(points, report)
    files = sorted({path for point in points.values() for path in point.files()})
    digests = {str(path): file_digest(path) for path in files}
    keys = dict.fromkeys(key for point in points.values() for key in point.values)
    extra = [key for key in keys if key not in (*REQUESTED, *MEASURED, ERROR)]
    estimated = any(point.scene.estimates_error for point in points.values())
    batch = Batch(
        out,
        "sweep",
        {"scene": str(scene), "axes": lists, "files": digests, "petsc": options},
        ["point", *REQUESTED, *extra, "ranks", *MEASURED, *([ERROR] if estimated else [])],
        limits,
        inputs=files,
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
    return pd.read_csv(batch.table)


def _keep_equations(points: Mapping[str, Point], report: Callable[[str], None]) -> dict[str, Point]:
    """Return points whose materials keep one equation at all nu.

    Of materials whose equation would change with nu it is that of the largest; otherwise a curve
    over nu would have a jump.
    """
    at_ratios: dict[tuple[int, str], dict[float, MaterialChoice]] = {}
    for point in points.values():
        for place, material in enumerate(point.scene.materials):
            at_ratios.setdefault((place, material.label), {})[material.nu] = material
    kept: dict[tuple[int, str], dict[str, Any]] = {}
    for (place, label), by_ratio in at_ratios.items():
        defaults = [material.default_variants() for _, material in sorted(by_ratio.items())]
        kept[place, label] = {
            k: v for k, v in defaults[-1].items() if any(d.get(k, v) != v for d in defaults)
        }
        for key, value in kept[place, label].items():
            equation = variants(function(label))[key].equations[value]
            report(
                f"material.{key} = {value_text(value)} at all nu: {label} has {equation}, its "
                f"default at the largest; --set material.{key} sets another"
            )

    def with_kept(point: Point) -> Point:
        several = len(point.scene.materials) > 1
        values = {
            f"material.{f'{place}.' if several else ''}{key}": value
            for place, material in enumerate(point.scene.materials)
            for key, value in kept[place, material.label].items()
            if material.parameters.get(key) is None
        }
        if not values:
            return point
        values = {**point.values, **values}
        return replace(point, values=values, scene=scenes.load(point.name, **values))

    return {name: with_kept(point) for name, point in points.items()}


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
        # What not every file system accepts is replaced.
        name = plain = re.sub(r"[^\w.=+-]+", "_", "__".join(parts)) or "point"
        for number in itertools.count(2):  # other values can have the same name: "a b", "a_b"
            if points.setdefault(name, values) == values:
                break
            name = f"{plain}-{number}"
    return points
