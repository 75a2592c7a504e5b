"""Run the points of a study, here or by a scheduler, and append a row when a point ends.

A `Batch` owns a folder: NAME.json (the definition of the study), NAME.csv (the rows) and one folder
per point with its log and its record. A point that has a row is not run again, so an interrupted
study continues when it is started again. A point is run in a child process of this one, or of an
element of an array of jobs (`fem_snh.studies.jobs`); its row is made here in both cases.
"""

from __future__ import annotations

import subprocess
import time
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput
from fem_snh.files import output_path
from fem_snh.processes import Interrupts
from fem_snh.records.notes import with_notes
from fem_snh.studies.folder import LOG, StudyFolder
from fem_snh.studies.jobs import Jobs
from fem_snh.studies.point import Limits, Point
from fem_snh.studies.processes import Child, environment, program
from fem_snh.studies.schedulers import Submission
from fem_snh.studies.table import NO_NOTES, StudyTable, read_record
from fem_snh.studies.tasks import End, Task, TaskRunner, read_end

#: Seconds between two polls of the running points.
_POLL_INTERVAL = 0.005


class Batch:
    """The folder and the table of a study, and the loop that runs its points.

    Only one process may use a folder; as a context, a batch releases it at the end.

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
    inputs : iterable of Path
        Files that the study reads.
    retry : bool
        Run again the points of earlier calls that failed.
    overwrite : bool
        Delete an earlier study in ``out``.
    report : callable
        Called with one line per point.

    Raises
    ------
    BadInput
        As from `fem_snh.studies.folder.StudyFolder`.
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
        self.name, self.limits, self.report = name, limits, report
        program(limits.ranks)  # fails here, before anything runs, if there is no mpirun
        definition = {**definition, "ranks": limits.ranks}
        self.out = output_path("out", out)
        self._jobs = Jobs(self.out)
        if overwrite:
            self._check_queue(self._queued())
        self._folder = StudyFolder(out, name, definition, inputs, overwrite)
        if self._folder.note:
            report(f"note: {self._folder.note}")
        if overwrite:
            self._jobs.clear()
        self.table = StudyTable(self.out / f"{name}.csv", columns)
        self._retry = retry

    def __enter__(self) -> Batch:
        return self

    def __exit__(self, *_: object) -> None:
        self._folder.close()

    def register(self, points: Mapping[str, Point]) -> None:
        """Check the rows and folders of points before they run; see `StudyFolder.register`."""
        kept = (row for row in self.table.rows() if not self._is_repeated(row))
        self._folder.register(points, (row["point"] for row in kept))

    def _is_repeated(self, row: Mapping[str, Any]) -> bool:
        """Return whether the point of a row is run again."""
        return self._retry and row["converged"] != "True"

    def run(self, points: Mapping[str, Point]) -> bool:
        """Run the points that have no row; a failed point has a row with the reason.

        With a `Submission` in the limits it appends the rows of the points that have ended, submits
        those that have neither ended nor are in the queue, and returns.

        Returns
        -------
        bool
            Whether all points have rows.

        Raises
        ------
        BadInput
            Before anything runs if a row is not that of its point; see `register`. If points are
            in the queue of a scheduler, and other points are to run here; if the scheduler does
            not answer.
        """
        self.register(points)
        queued = self._queued()
        if self._retry:  # rows of points that are not asked for stay
            failed = {row["point"] for row in self.table.rows() if self._is_repeated(row)}
            self.table.drop(failed & set(points))
            for name in failed & set(points):
                self._folder.discard(name)
        rows = {row["point"]: row for row in self.table.rows()}
        if present := len(rows.keys() & points):
            self.report(f"{present} of {len(points)} points are there already")
        for name, point in points.items():
            if name not in rows and (end := read_end(self.out / name)):
                row = self._result(name, point, end)
                present += 1
                rows[name] = self._append(name, row, present, len(points))
        waiting = [name for name in points if name not in rows and name not in queued]
        if isinstance(self.limits.jobs, Submission):
            self._submit(points, waiting, rows, queued, self.limits.jobs)
        else:
            if waiting or queued.keys() & points:
                self._check_queue(queued)
            self._run_here(points, waiting, rows, self.limits.jobs)
        return not points.keys() - {row["point"] for row in self.table.rows()}

    def _queued(self) -> dict[str, str]:
        """Return the points of this study that a scheduler has, and their states."""
        jobs = self.limits.jobs
        return self._jobs.queued(jobs.scheduler if isinstance(jobs, Submission) else None)

    def _check_queue(self, queued: Mapping[str, str]) -> None:
        """Raise BadInput if a scheduler has points of this study."""
        if queued:
            raise BadInput(
                f"out = {self.out}: {len(queued)} points are in the queue of a scheduler: expected "
                "--scheduler, --collect, or that they are cancelled"
            )

    def _submit(
        self,
        points: Mapping[str, Point],
        waiting: Sequence[str],
        rows: dict[str, Any],
        queued: Mapping[str, str],
        submission: Submission,
    ) -> None:
        """Submit the points that are waiting, and report how many are where."""
        if submission.submit and waiting:
            tasks = [self._task(name, points[name]) for name in waiting]
            for name in waiting:
                self._folder.begin(name)
            for line in self._jobs.submit(tasks, submission):
                self.report(line)
            return
        states = Counter(queued[name] for name in points if name in queued)
        states["not in the queue"] = len(waiting)
        parts = [f"{number} {state}" for state, number in states.items() if number]
        if parts:
            there = len(rows.keys() & points)
            self.report(f"{len(points)} points: {there} in the table, {', '.join(parts)}")

    def _run_here(
        self,
        points: Mapping[str, Point],
        waiting: list[str],
        rows: dict[str, Any],
        jobs: int,
    ) -> None:
        """Run the points that are waiting in child processes, ``jobs`` at a time."""
        running: dict[str, Child] = {}
        ended = len(points) - len(waiting)
        runner = TaskRunner()
        tasks = {name: self._task(name, points[name]) for name in waiting}
        with Interrupts() as interrupts:
            try:
                while waiting or running:
                    with interrupts.postponed():  # an interrupt here would lose a new child
                        while waiting and len(running) < jobs:
                            task = tasks[name := waiting.pop(0)]
                            running[name] = runner.start(task, self._folder.begin(name))
                        for name in [name for name in running if running[name].poll() is not None]:
                            child = running.pop(name)
                            end = End(child.poll() or 0, child.seconds, child.limit_reached)
                            row = self._result(name, points[name], end)
                            runner.keep_or_close(child, bool(waiting))
                            ended += 1
                            rows[name] = self._append(name, row, ended, len(points))
                    time.sleep(_POLL_INTERVAL)
            finally:
                for child in running.values():
                    child.end()
                runner.close()

    def draw(self) -> None:
        """Draw NAME.png in a process of its own; report a failure without an exception."""
        picture = self.out / f"{self.name}.png"
        command = [*program(1), "plot", str(self.table.path), "--out", str(picture)]
        pipe = subprocess.PIPE
        drawing = subprocess.Popen(
            command,
            env=environment(),
            stdin=subprocess.DEVNULL,
            stdout=pipe,
            stderr=pipe,
            text=True,
        )
        import_module("pandas")  # the caller reads the table with it: meanwhile
        out, errors = drawing.communicate()
        output = (out if drawing.returncode == 0 else errors).strip().splitlines()
        said = output[-1] if output else f"exit code {drawing.returncode}"
        failed = not output or drawing.returncode != 0
        self.report(f"no picture: {said.removeprefix('fem-snh: error: ')}" if failed else said)

    def _task(self, name: str, point: Point) -> Task:
        """Return what a process needs to know of a point."""
        arguments = tuple(point.arguments(self.out / name))
        limits = self.limits
        return Task(name, point.module, arguments, limits.ranks, limits.timeout, limits.memory)

    def _row(self, name: str, point: Point) -> dict[str, Any]:
        """Return the columns of a point that are known before it runs."""
        requested = {  # dotted keys of a scene are columns only where the study varies them
            key: value
            for key, value in point.requested().items()
            if "." not in key or key in self.table.columns
        }
        return {"point": name, "ranks": self.limits.ranks, **requested}

    def _result(self, name: str, point: Point, end: End) -> dict[str, Any]:
        """Return the row of a point that has ended."""
        record = read_record(self.out / name)
        row = self._row(name, point)
        row |= point.measured(record, self.out / name / LOG, end.code)
        row["seconds"] = row["seconds"] or end.seconds
        return row | ({"converged": False, "status": end.limit} if end.limit else {})

    def _append(self, name: str, row: dict[str, Any], count: int, of: int) -> dict[str, Any]:
        """Append a row to the table and report it."""
        self.table.append(row)
        seconds = f", {row['seconds']:.1f} s" if row.get("seconds") else ""
        status = row["status"]
        if (notes := row.get("notes", NO_NOTES)) != NO_NOTES:
            status = f"{with_notes(status, len(notes.split()))} ({notes})"
        self.report(f"[{count}/{of}] {name}: {status}{seconds}")
        return row
