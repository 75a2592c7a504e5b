"""Write the output of a run as it comes: run.json, tables, checkpoint and fields."""

from __future__ import annotations

import resource
from collections.abc import Sequence
from contextlib import suppress
from time import perf_counter
from typing import TYPE_CHECKING

from fem_snh.cache import Stopwatch, untimed
from fem_snh.choices import LOAD_DIGITS
from fem_snh.errors import BadInput, on_root
from fem_snh.records.run_record import NOTES_ON_PATH, Note, Record
from fem_snh.runs.checkpoint import CheckpointWriter
from fem_snh.runs.folder import Folder
from fem_snh.steps.jump_detection import jump_notes

if TYPE_CHECKING:
    from fem_snh.accuracy.goal_errors import Estimate
    from fem_snh.accuracy.path_errors import GoalHistory
    from fem_snh.problem.goals import Goal
    from fem_snh.problem.modes import VibrationModes
    from fem_snh.runs.output.fields import Fields
    from fem_snh.runs.scene_goals import GoalStates
    from fem_snh.runs.setup import Setup

#: Largest share of a run's time for its record and checkpoint beyond the first steps. They are
#: written whole, and take longer with each step: after each of 2,000 small steps, ten times as long
#: as the steps.
_FIRST_STEPS, _SHARE = 100, 0.1


class Recorder:
    """A context that records every step in run.json and writes the output.

    With very many quick steps the record and the checkpoint are not written after each step. The
    checkpoint is written before the other files, so that every step in run.json can be resumed
    while the run goes on. If an exception leaves the context, rank 0 writes run.json with all
    steps, of which the last may not be in the checkpoint, and with the reason as the status.

    Parameters
    ----------
    record : dict
        The content of run.json, updated in place.
    setup : Setup
        The scene, its problem and load steps.
    folder : Folder or None
        The folder of the output; None writes nothing.
    start : float
        The value of `time.perf_counter` at the start of the run.
    earlier : mapping, optional
        The record of the run that is resumed: its steps are kept and its seconds are added.
    goals : sequence of Goal, optional
        The goals whose errors `add_estimate` adds.
    """

    def __init__(
        self,
        record: Record,
        setup: Setup,
        folder: Folder | None,
        start: float,
        earlier: Record | None = None,
        goals: Sequence[Goal] = (),
    ) -> None:
        self.record, self._folder, self._start = record, folder, start
        self._stepper, self._problem = setup.stepper, setup.problem
        self._seconds, self._processor = setup.seconds, setup.processor
        self._watch = setup.watch
        self._checkpoint = CheckpointWriter(folder, setup) if folder else None
        self._earlier = earlier or {}
        #: The goals after each step, if the run was not resumed; and the states in which they are
        #: evaluated, if these do not depend on the path.
        self.history: GoalHistory | None = None
        self.states: GoalStates | None = None
        if goals:
            from fem_snh.accuracy.path_errors import GoalHistory
            from fem_snh.runs.scene_goals import GoalStates

            self.history = None if earlier else GoalHistory(setup.problem, goals)
            if not setup.depends_on_path:
                self.states = GoalStates(setup, goals, earlier is not None)
        self._fields: Fields | None = None
        if earlier is not None:
            notes = record.pop("notes", [])
            record |= {key: value for key, value in earlier.items() if key not in record}
            record.pop("notes", None)
            record["steps"] = list(earlier["steps"])
            kept = [note for note in earlier.get("notes", ()) if note["kind"] in NOTES_ON_PATH]
            if notes := [*notes, *kept]:
                record["notes"] = notes
            record["resumed"] = [*earlier.get("resumed", []), self._problem.load]
        elif folder:
            folder.clear()
        if folder:
            from fem_snh.runs.output.fields import Fields

            names = [name for goal in goals for name in goal.asked]
            path, resumed = folder.path / "fields.pvd", earlier is not None
            self._fields = Fields(path, setup, resumed, names)
            if self._fields.group_names:
                record["cell_groups"] = self._fields.group_names
        self._output = 0.0
        #: Whether a state that converged has not been written.
        self._behind = False
        #: When the record may be written again, by `time.perf_counter`.
        self._due = start

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, _: object, error: BaseException | None, *__: object) -> None:
        # After an exception the ranks may be in different calls: nothing collective is possible.
        if error is not None and self._problem.comm.rank == 0:
            was_stopped = isinstance(error, KeyboardInterrupt)
            status = "interrupted" if was_stopped else f"failed: {one_line(error)}"
            with suppress(BadInput):  # e.g. a full disk, which the exception reports
                self._write(status)

    def add_step(self, row: Record) -> None:
        """Add a step's row and write the output, with the state if it converged. Collective.

        A dynamic scene may ask for output after some of its steps only.
        """
        self.add_notes(jump_notes(self._stepper.jump, len(self.record["steps"])))
        self.record["steps"].append(row)
        if row["converged"]:
            with untimed(self._problem):
                for kept in (self.history, self.states):
                    if kept:
                        kept.add()
        if self._stepper.is_output(row):
            self.save("running", state=row["converged"])
        else:
            self._behind |= row["converged"]

    def add_notes(self, notes: Sequence[Note]) -> None:
        """Add notes on the run."""
        if notes:
            self.record.setdefault("notes", []).extend(note.record() for note in notes)

    def add_modes(self, modes: VibrationModes) -> None:
        """Add the eigenfrequencies and write the mode shapes. Collective."""
        watch = Stopwatch()
        self.record["modes"] = modes.record
        self._seconds = self._seconds | {"modes": modes.seconds}
        if self._folder:
            from fem_snh.runs.output.fields import write_modes

            write_modes(self._folder.path / "modes.pvd", self._problem, modes)
        self._output += watch.seconds

    def add_estimate(self, estimate: Estimate) -> None:
        """Add the goals and their estimated errors, also to the rows of their loads. Collective.

        The state at load 1 is written with the errors in the cells.
        """
        self.record["estimate"] = estimate.record()
        self.record["goals"] = {name: goal.record() for name, goal in estimate.asked.items()}
        rows = {round(r["load"], LOAD_DIGITS): r for r in self.record["steps"] if r["converged"]}
        for name, goal in estimate.asked.items():
            load = round(estimate.loads.get(name, self._problem.load), LOAD_DIGITS)
            by_load: dict[float, tuple[float, float | None, float | None]] = {}
            if curve := estimate.curves.get(name):
                by_load = {
                    at: (v, curve.errors[at], curve.bounds[at]) for at, v in curve.values.items()
                }
            by_load[load] = goal.value, goal.error, goal.bound
            for at in by_load.keys() & rows.keys():  # others are between steps
                for key, value in zip(("goals", "errors", "bounds"), by_load[at], strict=True):
                    rows[at].setdefault(key, {})[name] = value
        for name, goal in self.record["goals"].items():
            if name in estimate.loads:
                goal["at"] = estimate.loads[name]
        self._seconds = self._seconds | {"estimate": estimate.seconds - estimate.jit}
        if self._fields:
            watch = Stopwatch()
            self._fields.write_errors(self._problem, estimate.indicators)
            self._output += watch.seconds

    @property
    def writes_fields(self) -> bool:
        """Whether there are files for fields."""
        return self._fields is not None

    def save(self, status: str, state: bool = False) -> None:
        """Write the output. Collective.

        Parameters
        ----------
        status : str
            The run's status: "running", "converged" or the reason of a failure.
        state : bool
            Write the checkpoint and the fields, too; at the end of the run this is also done for a
            state that was not written. While the run goes on, the record and the checkpoint may
            wait: see `_SHARE`.

        Raises
        ------
        BadInput
            On every rank, if a file cannot be written.
        """
        watch = Stopwatch()
        comm = self._problem.comm
        # ru_maxrss is in KiB.
        peak = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        self.record["peak_memory_mb"] = max(peak, self._earlier.get("peak_memory_mb", 0.0))
        processor = comm.allreduce(self._processor + self._stepper.processor)
        processor += self._earlier.get("processor_seconds", 0.0)
        self.record["processor_seconds"] = processor
        self._update(status)
        running = status == "running"
        state |= self._behind and not running
        due = not running or self._is_due(state)
        self._behind = (self._behind or state) and not (due and state)
        if self._checkpoint and due and state:
            self._checkpoint.write(self.record)
        taken = watch.seconds
        if self._fields and state:
            self._fields.write(self._problem)
        self._output += watch.seconds
        if not due:
            return
        start = perf_counter()
        on_root(comm, self._write, status)
        now = perf_counter()
        self._due = now + (taken + now - start) * (1 / _SHARE - 1)

    def _is_due(self, state: bool) -> bool:
        """Return whether a running run's record is to be written now. Collective.

        A failed step waits for the previous state, so that each step in run.json can be resumed.
        """
        if len(self.record["steps"]) <= _FIRST_STEPS:
            return True
        in_time = self._problem.comm.bcast(perf_counter() >= self._due)
        return in_time and (state or not self._behind)

    def _update(self, status: str) -> None:
        """Update the status and the elapsed seconds."""
        assemble = self._problem.seconds["assemble"]
        self.record["status"] = status
        self.record["converged"] = status == "converged"
        seconds = {"jit": self._watch.jit} | self._seconds
        seconds |= {
            "assemble": assemble,
            "solve": self._stepper.seconds - assemble,
            "output": self._output,
            "total": perf_counter() - self._start,
        }
        before = self._earlier.get("seconds", {})
        self.record["seconds"] = {key: v + before.get(key, 0.0) for key, v in seconds.items()}

    def _write(self, status: str) -> None:
        """Update the record and write run.json and the tables. Not collective."""
        watch = Stopwatch()
        self._update(status)
        if self._folder:
            self._folder.write(self.record)
            self._output += watch.seconds


def one_line(error: BaseException) -> str:
    """Return an exception's message in one line, or its type if it has no message."""
    return " ".join(str(error).split()) or type(error).__name__
