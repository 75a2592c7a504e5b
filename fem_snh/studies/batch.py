"""The folder of a study: its definition, its table, and the loop that runs its points.

The folder holds NAME.json (the definition of the study), NAME.csv (the rows) and one folder per
point with its log, its record and its end. A point that has ended is not run again, so an
interrupted study continues when it is started again. The rows follow from the folders of the
points; the table is written again when a point ends.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh import cache
from fem_snh.errors import BadInput
from fem_snh.files import output_path, read_text, remove, remove_leftovers, replace_file
from fem_snh.records.run_files import FolderLock, check_inputs, list_others
from fem_snh.records.run_record import with_notes
from fem_snh.studies.points import (
    NO_NOTES,
    Limits,
    Point,
    measured_columns,
    read_record,
    requested_columns,
)
from fem_snh.studies.processes import (
    LOG,
    End,
    Task,
    program,
    read_end,
    remove_point,
    run_tasks,
)
from fem_snh.studies.slurm import Slurm, clear, queued

#: Seconds between two versions of the table while points end.
_WRITE_INTERVAL = 1.0
#: Hidden file that is the lock of the folder.
_LOCK = ".study"
#: Key of the definition that has the points: a digest of the command of each.
_POINTS = "points"


class Batch:
    """A study in its folder, which is created, and which one process at a time may use.

    NAME.json holds the definition and the names of the points before a point writes anything, so
    that no other folder is ever taken for one of a point. As a context, a batch releases the folder
    at the end.

    Parameters
    ----------
    out : str or Path
        The folder.
    name : str
        Name of the study: its files are NAME.json, NAME.csv, NAME.png.
    definition : mapping
        The values that all rows of the table share.
    columns : sequence of str
        Columns of the table.
    limits : Limits
        How many points run at a time, and the limits of each.
    inputs : iterable of Path
        Files that the study reads.
    retry : bool
        Run again the points of earlier calls that failed.
    overwrite : bool
        Delete an earlier study in ``out``; accept a folder that holds other files, which stay.
    report : callable
        Called with one line per point.

    Raises
    ------
    BadInput
        If ``out`` holds a study of another definition, or files of no study, and ``overwrite`` is
        false; if it holds an input that the study would replace; if another process uses it, or it
        cannot be written.
    """

    def __init__(
        self,
        out: str | Path,
        name: str,
        definition: Mapping[str, Any],
        columns: Sequence[str],
        limits: Limits,
        *,
        inputs: Iterable[Path] = (),
        retry: bool = False,
        overwrite: bool = False,
        report: Callable[[str], None] = print,
    ) -> None:
        self.name, self.limits, self.report, self._retry = name, limits, report, retry
        program(limits.ranks)  # fails here, before anything runs, if there is no mpirun
        self._definition = json.loads(json.dumps({**definition, "ranks": limits.ranks}))
        self.out = output_path("out", out)
        if overwrite:
            self._check_queue(queued(self.out))
        try:
            self.out.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"out = {out}: cannot be written: {error.strerror}") from None

        def is_own(file: str) -> bool:
            return Path(file).stem == name

        check_inputs(self.out, inputs, is_own)
        self._lock = FolderLock(self.out / _LOCK)
        if self._lock.note:
            report(f"note: {self._lock.note}")
        try:
            remove_leftovers(self.out, is_own)
            self._points = self._open(overwrite)
            self._write()
        except BaseException:
            self._lock.release()
            raise
        self.table, self._columns = self.out / f"{name}.csv", list(columns)

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def _open(self, overwrite: bool) -> dict[str, Any]:
        """Return the points of an earlier study in the folder; refuse or remove one."""
        file = self.out / f"{self.name}.json"
        try:
            earlier = json.loads(read_text(file))
        except (OSError, ValueError, RecursionError):
            earlier = None
        earlier = earlier if isinstance(earlier, dict) else {}
        points = earlier.pop(_POINTS, {})
        points = points if isinstance(points, dict) else {}
        if overwrite:
            for point in points:
                remove_point(self.out / point)
            remove(self.out / f"{self.name}.csv")
            clear(self.out)
            return {}
        if not file.exists() and (others := list_others(self.out)):
            raise BadInput(
                f"out = {self.out}: holds what is not of a {self.name} study ({others}): expected "
                "a new or an empty folder, or --overwrite"
            )
        if file.exists() and earlier != self._definition:
            keys = dict.fromkeys([*self._definition, *earlier])
            other = [k for k in keys if earlier.get(k) != self._definition.get(k)]
            raise BadInput(
                f"out = {self.out}: holds {self.name}.csv of other {', '.join(other)}: "
                "expected another folder, or --overwrite"
            )
        return points

    def _write(self) -> None:
        text = json.dumps(self._definition | {_POINTS: self._points}, indent=1)
        replace_file(self.out / f"{self.name}.json", text)

    def _register(self, points: Mapping[str, Point]) -> None:
        """Note the points before any of them writes.

        Raises BadInput if a point that has ended was run by another command, as by that of another
        version, or the folder of a point is not that of a point of this study.
        """
        commands = {
            name: {"values": cache.key("fem_snh", point.arguments(Path()))}
            for name, point in points.items()
        }
        for name, command in commands.items():
            if name not in self._points and list_others(self.out / name):
                raise BadInput(
                    f"out = {self.out}: its folder {name} is not one of this study: expected "
                    "another folder"
                )
            if read_end(self.out / name) and self._points.get(name, command) != command:
                raise BadInput(
                    f"out = {self.out}: {name} in {self.name}.csv was computed with other "
                    "values: expected another folder, or --overwrite"
                )
        if (registered := self._points | commands) != self._points:
            self._points = registered
            self._write()

    def run(self, points: Mapping[str, Point]) -> bool:
        """Run the points that have no row; a failed point has a row with the reason.

        With `Slurm` in the limits it appends the rows of the points that have ended, submits those
        that have neither ended nor are in the queue, and returns.

        Returns
        -------
        bool
            Whether all points have rows.

        Raises
        ------
        BadInput
            Before anything runs if a row is not that of its point, or a folder of another. If
            points are in the queue of Slurm, and other points are to run here; if Slurm does not
            answer.
        """
        self._register(points)
        waiting = queued(self.out)
        rows: dict[str, dict[str, Any]] = {}
        for name, point in points.items():
            if end := read_end(self.out / name):
                row = self._row(name, point, end)
                if self._retry and not row["converged"]:
                    remove_point(self.out / name)
                else:
                    rows[name] = row
        if rows:
            self.report(f"{len(rows)} of {len(points)} points are there already")

        def add(task: Task, end: End) -> None:
            row = rows[task.name] = self._row(task.name, points[task.name], end)
            if time.monotonic() > self._written + _WRITE_INTERVAL:
                self._write_table(rows, points)
            status = row["status"]
            if (notes := row["notes"]) != NO_NOTES:
                status = f"{with_notes(status, len(notes.split()))} ({notes})"
            self.report(
                f"[{len(rows)}/{len(points)}] {task.name}: {status}, {row['seconds']:.1f} s"
            )

        limits = self.limits
        tasks = [
            Task(name, tuple(point.arguments(self.out / name)), limits.ranks, limits.timeout,
                 limits.memory)
            for name, point in points.items()
            if name not in rows and name not in waiting
        ]  # fmt: skip
        self._write_table(rows, points)
        if isinstance(limits.jobs, Slurm):
            for task in tasks:
                remove_point(self.out / task.name)
            for line in limits.jobs.submit(self.out, tasks) if tasks else ():
                self.report(line)
        else:
            if tasks or waiting.keys() & points:
                self._check_queue(waiting)
            try:
                run_tasks(self.out, tasks, limits.jobs, add)
            finally:
                self._write_table(rows, points)
        return len(rows) == len(points)

    def _write_table(self, rows: Mapping[str, Mapping[str, Any]], points: Iterable[str]) -> None:
        """Write NAME.csv; the results, whose names contain a dot, are its last columns."""
        results = (key for row in rows.values() for key in row if "." in key)
        columns = list(dict.fromkeys([*self._columns, *results]))
        ordered = [rows[name] for name in points if name in rows]
        table = pd.DataFrame(ordered, columns=columns, dtype=object)
        replace_file(self.table, table.to_csv(index=False))
        self._written = time.monotonic()

    def _check_queue(self, waiting: Mapping[str, str]) -> None:
        """Raise BadInput if Slurm has points of this study."""
        if waiting:
            raise BadInput(
                f"out = {self.out}: {len(waiting)} points are in the queue of Slurm: expected "
                "--scheduler slurm, or that they are cancelled"
            )

    def draw(self) -> None:
        """Draw NAME.png; report a failure without an exception."""
        try:
            from fem_snh.viewing.plots import main  # matplotlib

            self.report(str(main([self.table], self.out / f"{self.name}.png")))
        except (BadInput, ImportError) as error:
            self.report(f"no picture: {error}")

    def _row(self, name: str, point: Point, end: End) -> dict[str, Any]:
        """Return the row of a point that has ended."""
        columns = {**point.values, **requested_columns(point.scene)}
        # Dotted keys of a scene are columns only where the study varies them.
        row = {k: v for k, v in columns.items() if "." not in k or k in self._columns}
        row |= {"point": name, "ranks": self.limits.ranks}
        row |= measured_columns(read_record(self.out / name), self.out / name / LOG, end.code)
        row["seconds"] = row["seconds"] or end.seconds
        return row | ({"converged": False, "status": end.limit} if end.limit else {})
