"""The points of a study: each a command in processes of its own, each a row the moment it ends.

A `Campaign` owns a folder: NAME.json (what was asked), NAME.csv (the rows) and a folder for each
point with its log and the record that it leaves. What is in the table is not run again: a campaign
that was ended, however, goes on where it was. What a point runs it says itself: see `Point`.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from fem_snh.atomic_files import put
from fem_snh.errors import BadInput
from fem_snh.runs.interrupts import Interrupts
from fem_snh.studies.processes import Child, environment, program
from fem_snh.studies.table import Table, read_record

#: What a study adds to the row of a point: from its record, and the row so far.
More = Callable[[Mapping[str, Any], Mapping[str, Any]], Mapping[str, Any]]


@dataclass(frozen=True)
class Limits:
    """How many points at a time, and what each may take; BadInput for what makes no sense.

    Attributes:
        jobs: points at a time.
        ranks: MPI ranks of each.
        timeout: seconds after which a point is given up.
        memory: GiB of RAM above which it is.
    """

    jobs: int = 1
    ranks: int = 1
    timeout: float | None = None
    memory: float | None = None

    def __post_init__(self) -> None:
        for key in ("jobs", "ranks"):
            count = getattr(self, key)
            if not isinstance(count, int) or isinstance(count, bool) or count < 1:
                raise BadInput(f"{key} = {count}: expected a whole number, 1 or more")
        for key, unit in {"timeout": "seconds", "memory": "GiB"}.items():
            most = getattr(self, key)
            number = isinstance(most, int | float) and not isinstance(most, bool)
            if most is not None and not (number and most > 0):
                raise BadInput(f"{key} = {most}: expected {unit}, a number > 0")


@dataclass(frozen=True, kw_only=True)
class Point(ABC):
    """One command, and what its row makes of the record that it leaves in its folder.

    Attributes:
        timeout: of this point, if not the campaign's.
        after: the name of a point that must have ended before: the same on a coarser mesh.
        growth: by how much more than ``after`` it takes, at the least. If that is more than the
            limit, or ``after`` had reached a limit itself, it is not tried.
        columns: what its row holds besides, whatever becomes of it.
    """

    timeout: float | None = None
    after: str | None = None
    growth: float = 1.0
    columns: Mapping[str, Any] = field(default_factory=dict)

    #: The module that is started, whether on several ranks, and the file that it leaves.
    module: ClassVar[str] = "fem_snh"
    parallel: ClassVar[bool] = True
    record: ClassVar[str] = "run.json"

    @abstractmethod
    def words(self, folder: Path) -> list[str]:
        """The module's arguments, for a point that may write into ``folder``."""

    @abstractmethod
    def asked(self) -> Mapping[str, Any]:
        """What its row holds of what was asked."""

    @abstractmethod
    def found(self, record: Mapping[str, Any], log: Path, code: int) -> Mapping[str, Any]:
        """What its row holds of what came out: ``converged``, ``status``, ``seconds``...

        From its record (empty if there is none), its log and its exit code.
        """


class Campaign:
    """A study's folder, its table, and the loop that fills it. Only one process may have it.

    Raises BadInput if ``out`` holds another study and ``overwrite`` is not given.
    """

    def __init__(
        self,
        out: Path,
        name: str,
        definition: Mapping[str, Any],
        columns: Sequence[str],
        limits: Limits,
        *,
        good: str = "converged",
        retry: bool = False,
        overwrite: bool = False,
        report: Callable[[str], None] = print,
    ) -> None:
        """``definition``: what rows in one table share; ``good``: the column of what need not be
        run again by ``retry``.
        """
        self.out, self.name, self.limits, self.report = out, name, limits, report
        program(limits.ranks)  # before anything runs: is there an mpirun?
        definition = {**definition, "ranks": limits.ranks}
        _prepare(out, name, definition, overwrite)
        self.table = Table(out / f"{name}.csv", columns)
        self._again = good if retry else ""

    def run(self, points: Mapping[str, Point], more: More | None = None) -> None:
        """Run the points that are not in the table; one that fails is a row with its reason."""
        if self._again:  # what is not asked for stays as it is
            bad = (r["point"] for r in self.table.rows() if r[self._again] != "True")
            self.table.drop(name for name in bad if name in points)
        rows = {row["point"]: row for row in self.table.rows()}
        waiting = [name for name in points if name not in rows]
        running: dict[str, Child] = {}
        ended = len(points) - len(waiting)
        if ended:
            self.report(f"{ended} of {len(points)} points are there already")
        with Interrupts() as interrupts:
            try:
                while waiting or running:
                    with interrupts.undivided():  # a child that is being made would be lost
                        for name in self._next(waiting, running, points):
                            waiting.remove(name)
                            point = points[name]
                            if reason := self._hopeless(point, rows.get(point.after or "")):
                                row = self._row(name, point)
                                row |= {"converged": False, "status": reason}
                                ended += 1
                                rows[name] = self._ended(name, row, ended, len(points))
                            else:
                                running[name] = self._begin(name, point)
                        for name in [name for name in running if running[name].poll() is not None]:
                            row = self._result(name, points[name], running.pop(name), more)
                            ended += 1
                            rows[name] = self._ended(name, row, ended, len(points))
                    time.sleep(0.02)
            finally:
                for child in running.values():
                    child.end()

    def draw(self) -> None:
        """NAME.png, by a process of its own: a table without its picture is still a result."""
        picture = self.out / f"{self.name}.png"
        command = [*program(1), "plot", str(self.table.path), "--out", str(picture)]
        drawn = subprocess.run(command, env=environment(), capture_output=True, text=True)
        said = (drawn.stdout if drawn.returncode == 0 else drawn.stderr).strip().splitlines()
        self.report(said[-1] if said else f"no picture: exit code {drawn.returncode}")

    # --- the loop's parts ------------------------------------------------------------------------

    def _next(
        self, waiting: Sequence[str], running: Mapping[str, Child], points: Mapping[str, Point]
    ) -> list[str]:
        """The points to begin now: as many as may be, in order, none before its coarser one."""
        not_yet = {*waiting, *running}
        ready = [name for name in waiting if points[name].after not in not_yet]
        return ready[: self.limits.jobs - len(running)]

    def _begin(self, name: str, point: Point) -> Child:
        folder = self.out / name
        shutil.rmtree(folder, ignore_errors=True)  # left by a point that was cut off
        folder.mkdir(parents=True)
        command = [*program(self._ranks(point), point.module), *point.words(folder)]
        return Child(command, folder / "log.txt", self._timeout(point), self.limits.memory)

    def _ranks(self, point: Point) -> int:
        return self.limits.ranks if point.parallel else 1

    def _timeout(self, point: Point) -> float | None:
        return point.timeout if point.timeout is not None else self.limits.timeout

    def _hopeless(self, point: Point, coarser: Mapping[str, Any] | None) -> str:
        """Why a point is not tried, after its coarser one."""
        if coarser is None:
            return ""
        if str(coarser["status"]).startswith(("given up", "not tried")):
            return f"not tried: {_after(coarser)}"
        limit, took = self._timeout(point), float(coarser["seconds"] or 0)
        if limit and took * point.growth > limit:
            return f"not tried: would take more than {limit:g} s"
        return ""

    def _row(self, name: str, point: Point) -> dict[str, Any]:
        row = {"point": name, "ranks": self._ranks(point), **point.asked()}
        return row | dict(point.columns)

    def _result(self, name: str, point: Point, child: Child, more: More | None) -> dict[str, Any]:
        record = read_record(self.out / name, point.record)
        row = self._row(name, point)
        row |= point.found(record, self.out / name / "log.txt", child.poll() or 0)
        row["seconds"] = row["seconds"] or child.seconds
        if child.given_up:
            row |= {"converged": False, "status": child.given_up}
        return row | dict(more(record, row) if more else {})

    def _ended(self, name: str, row: dict[str, Any], count: int, of: int) -> dict[str, Any]:
        self.table.append(row)
        seconds = f", {row['seconds']:.1f} s" if row.get("seconds") else ""
        self.report(f"[{count}/{of}] {name}: {row['status']}{seconds}")
        return row


def _after(coarser: Mapping[str, Any]) -> str:
    """What became of the coarser mesh, in words that are the same however far up it was."""
    status = str(coarser["status"])
    if status.startswith("not tried: "):
        return status.removeprefix("not tried: ")
    return f"{coarser['cells']} cells were {status}"


def _prepare(out: Path, name: str, definition: Mapping[str, Any], overwrite: bool) -> None:
    """Make ``out`` ready for this study, or for going on with it. BadInput if it holds another."""
    record = out / f"{name}.json"
    definition = json.loads(json.dumps(definition))
    try:
        earlier = json.loads(record.read_text(encoding="utf-8")) if record.exists() else None
    except ValueError:
        earlier = {}
    if earlier is not None and earlier != definition and not overwrite:
        other = [key for key in definition if earlier.get(key) != definition[key]]
        raise BadInput(
            f"{out} holds {name}.csv of other {', '.join(other)}: "
            "take another folder, or --overwrite it"
        )
    if overwrite and earlier is not None:
        for log in out.glob("*/log.txt"):  # every point has one, finished or cut off
            shutil.rmtree(log.parent, ignore_errors=True)
        (out / f"{name}.csv").unlink(missing_ok=True)
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot write into {out}: {error.strerror}") from None
    put(record, json.dumps(definition, indent=1))
