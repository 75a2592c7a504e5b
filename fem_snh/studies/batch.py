"""Run the points of a study in child processes, and append a row when a point ends.

A `Batch` owns a folder: NAME.json (the definition of the study), NAME.csv (the rows) and one folder
per point with its log and its record. A point that has a row is not run again, so an interrupted
study continues when it is started again.
"""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from fem_snh.interrupts import Interrupts
from fem_snh.notes import with_notes
from fem_snh.studies.folder import LOG, StudyFolder
from fem_snh.studies.point import Limits, Point
from fem_snh.studies.processes import Child, environment, program
from fem_snh.studies.table import NO_NOTES, StudyTable, read_record
from fem_snh.studies.workers import Worker

#: Computes further columns of a point's row from its record and the row so far. A key ``remark``
#: is no column; it is printed in the progress line of the point.
ExtraColumns = Callable[[Mapping[str, Any], Mapping[str, Any]], Mapping[str, Any]]

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
    success : str
        The column that is true for a point which ``retry`` does not run again.
    retry : bool
        Run again the points of earlier calls that failed.
    overwrite : bool
        Delete an earlier study in ``out``.
    reuse : bool
        Run the points, all of which are commands of ``fem-snh``, one after another in ``jobs``
        processes. A process is replaced after a point that fails.
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
        success: str = "converged",
        retry: bool = False,
        overwrite: bool = False,
        reuse: bool = False,
        report: Callable[[str], None] = print,
    ) -> None:
        self.name, self.limits, self.report = name, limits, report
        program(limits.ranks)  # fails here, before anything runs, if there is no mpirun
        definition = {**definition, "ranks": limits.ranks}
        self._folder = StudyFolder(out, name, definition, inputs, overwrite)
        self.out = self._folder.path
        if self._folder.note:
            report(f"note: {self._folder.note}")
        self.table = StudyTable(self.out / f"{name}.csv", columns)
        self._success, self._retry, self._reuse = success, retry, reuse
        self._idle: list[Worker] = []

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
        return self._retry and row[self._success] != "True"

    def run(self, points: Mapping[str, Point], extra: ExtraColumns | None = None) -> None:
        """Run the points that have no row; a failed point has a row with the reason.

        Raises BadInput before anything runs if a row is not that of its point; see `register`.
        """
        self.register(points)
        if self._retry:  # rows of points that are not asked for stay
            failed = (row["point"] for row in self.table.rows() if self._is_repeated(row))
            self.table.drop(name for name in failed if name in points)
        rows = {row["point"]: row for row in self.table.rows()}
        waiting = [name for name in points if name not in rows]
        running: dict[str, Child] = {}
        ended = len(points) - len(waiting)
        if ended:
            self.report(f"{ended} of {len(points)} points are there already")
        with Interrupts() as interrupts:
            try:
                while waiting or running:
                    with interrupts.postponed():  # an interrupt here would lose a new child
                        for name in self._startable(waiting, running, points):
                            waiting.remove(name)
                            point = points[name]
                            if reason := self._skip_reason(point, rows.get(point.after or "")):
                                row = self._row(name, point)
                                row |= {"converged": False, "status": reason}
                                ended += 1
                                rows[name] = self._append(name, row, ended, len(points))
                            else:
                                running[name] = self._start(name, point)
                        for name in [name for name in running if running[name].poll() is not None]:
                            child = running.pop(name)
                            row = self._result(name, points[name], child, extra)
                            self._keep_or_close(child, bool(waiting))
                            ended += 1
                            rows[name] = self._append(name, row, ended, len(points))
                    time.sleep(_POLL_INTERVAL)
            finally:
                for child in (*running.values(), *self._idle):
                    child.end()

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
        self.report(output[-1] if output else f"no picture: exit code {drawing.returncode}")

    def _startable(
        self, waiting: Sequence[str], running: Mapping[str, Child], points: Mapping[str, Point]
    ) -> list[str]:
        """Return the points to start now, in order, each only after the point it names."""
        not_ended = {*waiting, *running}
        ready = [name for name in waiting if points[name].after not in not_ended]
        return ready[: self.limits.jobs - len(running)]

    def _start(self, name: str, point: Point) -> Child:
        folder = self._folder.begin(name)
        arguments = point.arguments(folder)
        limits = self._timeout(point), self.limits.memory
        if not self._reuse:
            command = [*program(self._ranks(point), point.module), *arguments]
            return Child(command, folder / LOG, *limits)
        worker = self._idle.pop() if self._idle else Worker(self.limits.ranks)
        worker.start(arguments, folder / LOG, *limits)
        return worker

    def _keep_or_close(self, child: Child, wanted: bool) -> None:
        """Keep the worker of a point that has ended for another one, if that is ``wanted``."""
        if isinstance(child, Worker):
            if wanted and child.idle:
                self._idle.append(child)
            else:
                child.close()

    def _ranks(self, point: Point) -> int:
        return self.limits.ranks if point.parallel else 1

    def _timeout(self, point: Point) -> float | None:
        return point.timeout if point.timeout is not None else self.limits.timeout

    def _skip_reason(self, point: Point, coarser: Mapping[str, Any] | None) -> str:
        """Return why a point is skipped, from the row of its coarser point, or ""."""
        if coarser is None:
            return ""
        if str(coarser["status"]).startswith(("given up", "not tried")):
            return f"not tried: {_coarser_status(coarser)}"
        limit, seconds = self._timeout(point), float(coarser["seconds"] or 0)
        if limit and seconds * point.growth > limit:
            return f"not tried: would take more than {limit:g} s"
        return ""

    def _row(self, name: str, point: Point) -> dict[str, Any]:
        """Return the columns of a point that are known before it runs."""
        row = {"point": name, "ranks": self._ranks(point), **point.requested()}
        return row | dict(point.columns)

    def _result(
        self, name: str, point: Point, child: Child, extra: ExtraColumns | None
    ) -> dict[str, Any]:
        """Return the row of a point that has ended."""
        record = read_record(self.out / name, point.record)
        row = self._row(name, point)
        row |= point.measured(record, self.out / name / LOG, child.poll() or 0)
        row["seconds"] = row["seconds"] or child.seconds
        if child.limit_reached:
            row |= {"converged": False, "status": child.limit_reached}
        return row | dict(extra(record, row) if extra else {})

    def _append(self, name: str, row: dict[str, Any], count: int, of: int) -> dict[str, Any]:
        """Append a row to the table and report it."""
        self.table.append(row)
        seconds = f", {row['seconds']:.1f} s" if row.get("seconds") else ""
        remark = f" ({row['remark']})" if row.get("remark") else ""
        status = row["status"]
        if (notes := row.get("notes", NO_NOTES)) != NO_NOTES:
            status = f"{with_notes(status, len(notes.split()))} ({notes})"
        self.report(f"[{count}/{of}] {name}: {status}{seconds}{remark}")
        return row


def _coarser_status(coarser: Mapping[str, Any]) -> str:
    """Return the status of the coarsest mesh that failed, the same for all meshes above it."""
    status = str(coarser["status"])
    if status.startswith("not tried: "):
        return status.removeprefix("not tried: ")
    return f"{coarser['cells']} cells were {status}"
