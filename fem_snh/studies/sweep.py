"""Run a scene for every combination of some values, one row per point.

    >>> table = sweep("twist", "out/nu", {"nu": [0.3, 0.45, 0.49], "cells": 6}, jobs=2)

The folder holds sweep.json (the definition), sweep.csv (with the points that have ended),
sweep.png, on request bodies.png, and one folder per point with its run, its log and its end. A
point that has ended is not run again, so an interrupted sweep continues when it is called again.
The table is made from the folders of the points. Each point is a process of its own.
"""

from __future__ import annotations

import itertools
import json
import re
import time
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh import scenes
from fem_snh.errors import BadInput, check_whole
from fem_snh.files import (
    file_digest,
    output_path,
    read_text,
    remove,
    remove_leftovers,
    replace_file,
)
from fem_snh.materials import function
from fem_snh.materials.parameters import variants
from fem_snh.records.run_files import FolderLock, check_inputs, list_others
from fem_snh.records.run_record import with_notes
from fem_snh.references import file_of
from fem_snh.scenes import MaterialChoice
from fem_snh.studies.points import (
    ERROR,
    MEASURED,
    NO_NOTES,
    REQUESTED,
    measured_columns,
    read_record,
    requested_columns,
    run_arguments,
    value_text,
)
from fem_snh.studies.slurm import Slurm, clear, queued
from fem_snh.studies.tasks import LOG, End, Task, program, read_end, remove_point, run_tasks

#: Largest number of points at a time, and of ranks: more than the cores of any single machine.
MAX_PROCESSES = 4096
#: Seconds between two versions of the table while points end.
_WRITE_INTERVAL = 1.0
#: Hidden file that is the lock of the folder.
_LOCK = ".study"
#: The definition, and the table.
_DEFINITION, _TABLE = "sweep.json", "sweep.csv"


@dataclass(frozen=True)
class Point:
    """The values of a point, and the scene loaded with them."""

    values: Mapping[str, Any]
    scene: scenes.Scene


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
        Number of points that run at a time on this machine; or how points are submitted to Slurm.
        With Slurm the call does not wait; the same call later adds the rows of points that have
        ended.
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
        The field, e.g. "J", by which bodies.png is coloured: a picture of the bodies of all points
        at their last loads.
    report : callable
        Called with one line per point.

    Returns
    -------
    pandas.DataFrame
        One row per point. If a scene estimates errors, the column ``error`` has the largest
        estimated relative error of the point's goals.

    Raises
    ------
    BadInput
        Before anything runs: for a bad value, or if ``out`` holds another sweep.
    """
    if not isinstance(jobs, Slurm):
        check_whole("jobs", jobs, 1, MAX_PROCESSES)
    check_whole("ranks", ranks, 1, MAX_PROCESSES)
    for key, limit, unit in (("timeout", timeout, "seconds"), ("memory", memory, "GiB")):
        number = isinstance(limit, int | float) and not isinstance(limit, bool)
        if limit is not None and not (number and limit > 0):
            raise BadInput(f"{key} = {limit}: expected {unit}, a number > 0")
    program(ranks)  # fails here, before anything runs, if there is no mpirun
    lists = {key: list(v) if isinstance(v, list | tuple) else [v] for key, v in axes.items()}
    for key, values in lists.items():
        if any(callable(v) for v in values):  # the points are in other processes
            raise BadInput(f"{key}: expected names or references FILE.py:FUNCTION, no functions")
    options = dict(petsc or {})
    points = {
        name: Point(values, scenes.load(scene, **values))
        for name, values in combinations(lists).items()
    }
    points = _keep_equations(scene, points, report)
    read = {file_of(str(scene))}.union(*(point.scene.files.values() for point in points.values()))
    files = sorted(path for path in read if path.suffix)
    definition = {
        "scene": str(scene),
        "axes": lists,
        "files": {str(path): file_digest(path) for path in files},
        "petsc": options,
        "ranks": ranks,
    }
    folder = output_path("out", out)
    waiting = queued(folder)
    if waiting and (overwrite or not isinstance(jobs, Slurm)):
        raise BadInput(
            f"out = {out}: {len(waiting)} points are in the queue of Slurm: expected "
            "--scheduler slurm, or that they are cancelled"
        )
    limits = ranks, timeout, memory
    with closing(_open(folder, definition, files, overwrite, report)):
        rows = _Rows(folder, points, ranks, report)
        rows.read(retry)
        tasks = [
            Task(name, tuple(run_arguments(scene, folder / name, point.values, options)), *limits)
            for name, point in points.items()
            if name not in rows.rows and name not in waiting
        ]
        if isinstance(jobs, Slurm):
            for task in tasks:
                remove_point(folder / task.name)
            for line in jobs.submit(folder, tasks) if tasks else ():
                report(line)
        else:
            try:
                run_tasks(folder, tasks, jobs, rows.add)
            finally:
                rows.write()
        if len(rows.rows) < len(points):
            report(f"{len(points) - len(rows.rows)} points wait or run: call again for their rows")
        else:
            report(_draw(folder))
            if render is not None:
                report(_draw_bodies(folder, list(points), render))
    return pd.read_csv(folder / _TABLE)


def _open(
    out: Path,
    definition: Mapping[str, Any],
    inputs: list[Path],
    overwrite: bool,
    report: Callable[[str], None],
) -> FolderLock:
    """Create and lock the folder of a sweep, write the definition, and return the lock.

    With ``overwrite`` an earlier sweep is removed.

    Raises
    ------
    BadInput
        If the folder holds another sweep, files of no sweep, or an input that the sweep would
        replace; if another process uses it, or it cannot be written.
    """
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"out = {out}: cannot be written: {error.strerror}") from None

    def is_own(file: str) -> bool:
        return Path(file).stem == "sweep"

    check_inputs(out, inputs, is_own)
    lock = FolderLock(out / _LOCK)
    if lock.note:
        report(f"note: {lock.note}")
    try:
        remove_leftovers(out, is_own)
        file = out / _DEFINITION
        if not file.exists() and (others := list_others(out)):
            raise BadInput(
                f"out = {out}: holds what is not of a sweep ({others}): expected a new or an "
                "empty folder"
            )
        text = json.dumps(definition, indent=1)
        definition, earlier = json.loads(text), _earlier(file)
        if overwrite:
            for name in combinations(earlier.get("axes", {})):
                remove_point(out / name)
            remove(out / _TABLE)
            clear(out)
        elif file.exists() and earlier != definition:
            keys = dict.fromkeys([*definition, *earlier])
            other = [key for key in keys if earlier.get(key) != definition.get(key)]
            raise BadInput(
                f"out = {out}: holds {_TABLE} of other {', '.join(other)}: expected another "
                "folder, or --overwrite"
            )
        replace_file(file, text)
    except BaseException:
        lock.close()
        raise
    return lock


def _earlier(file: Path) -> dict[str, Any]:
    """Return the definition in a file; empty if it is missing or damaged."""
    try:
        return dict(json.loads(read_text(file)))
    except (OSError, ValueError, TypeError, RecursionError):
        return {}


class _Rows:
    """The rows of the points that have ended, and their table sweep.csv."""

    def __init__(
        self, out: Path, points: Mapping[str, Point], ranks: int, report: Callable[[str], None]
    ) -> None:
        self.out, self.points, self.ranks, self.report = out, points, ranks, report
        keys = dict.fromkeys(key for point in points.values() for key in point.values)
        extra = [key for key in keys if key not in (*REQUESTED, *MEASURED, ERROR)]
        error = [ERROR] * any(point.scene.estimates_error for point in points.values())
        self.columns = ["point", *REQUESTED, *extra, "ranks", *MEASURED, *error]
        self.rows: dict[str, dict[str, Any]] = {}

    def read(self, retry: bool) -> None:
        """Make the rows of earlier calls; with ``retry`` remove the points that failed."""
        for name in self.points:
            if end := read_end(self.out / name):
                row = self._row(name, end)
                if retry and not row["converged"]:
                    remove_point(self.out / name)
                else:
                    self.rows[name] = row
        if self.rows:
            self.report(f"{len(self.rows)} of {len(self.points)} points are there already")
        self.write()

    def add(self, task: Task, end: End) -> None:
        """Add the row of a point that has ended, report it, and write the table (once a second)."""
        row = self.rows[task.name] = self._row(task.name, end)
        if time.monotonic() > self._written + _WRITE_INTERVAL:
            self.write()
        status = row["status"]
        if (notes := row["notes"]) != NO_NOTES:
            status = f"{with_notes(status, len(notes.split()))} ({notes})"
        count = f"[{len(self.rows)}/{len(self.points)}]"
        self.report(f"{count} {task.name}: {status}, {row['seconds']:.1f} s")

    def _row(self, name: str, end: End) -> dict[str, Any]:
        """Return the row of a point that has ended."""
        point = self.points[name]
        row = {**point.values, **requested_columns(point.scene)}
        row |= {"point": name, "ranks": self.ranks}
        row |= measured_columns(read_record(self.out / name), self.out / name / LOG, end.code)
        row["seconds"] = row["seconds"] or end.seconds
        return row | ({"converged": False, "status": end.limit} if end.limit else {})

    def write(self) -> None:
        """Write the table; the results, whose names contain a dot, are its last columns."""
        results = (key for row in self.rows.values() for key in row if "." in key)
        columns = list(dict.fromkeys([*self.columns, *results]))
        ordered = [self.rows[name] for name in self.points if name in self.rows]
        table = pd.DataFrame(ordered, columns=columns, dtype=object)
        replace_file(self.out / _TABLE, table.to_csv(index=False))
        self._written = time.monotonic()


def _keep_equations(
    scene: str | Path, points: Mapping[str, Point], report: Callable[[str], None]
) -> dict[str, Point]:
    """Return points whose materials keep one equation at all nu; report each that is kept.

    A material whose default equation changes with nu has the default at the largest nu: otherwise
    curves over nu would jump.
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
        return Point(values, scenes.load(scene, **values))

    return {name: with_kept(point) for name, point in points.items()}


def _draw(out: Path) -> str:
    """Draw sweep.png; return its path, or the reason why it is missing."""
    try:
        from fem_snh.viewing.plots import main  # matplotlib

        return str(main([out / _TABLE], out / "sweep.png"))
    except (BadInput, ImportError) as error:
        return f"no picture: {error}"


def _draw_bodies(out: Path, points: list[str], field: str) -> str:
    """Draw bodies.png; return its path, or the reason why it is missing."""
    from fem_snh.viewing.render import compare

    drawn = [name for name in points if (out / name / "fields.pvd").exists()]
    labels = [name.replace("__", ", ").replace("=", " = ") for name in drawn]
    try:
        folders = [out / name for name in drawn]
        return str(compare(folders, out / "bodies.png", labels=labels, field=field))
    except BadInput as error:
        return f"no picture of the bodies: {error}"


def combinations(lists: Mapping[str, list[Any]]) -> dict[str, dict[str, Any]]:
    """Map the name of every point, made of the values that differ, to its values."""
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
