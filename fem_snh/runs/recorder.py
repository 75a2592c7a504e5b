"""Keeps run.json, steps.csv, the checkpoint and the fields up to date while a run goes on."""

from __future__ import annotations

import resource
from collections.abc import Mapping
from contextlib import suppress
from time import perf_counter
from typing import Any

from fem_snh.errors import BadInput, on_root
from fem_snh.fem.modes import Modes
from fem_snh.runs.checkpoint import Writer
from fem_snh.runs.fields import Fields, write_modes
from fem_snh.runs.folder import Folder
from fem_snh.runs.stepping import Stepper


class Recorder:
    """Brings ``record`` up to date after every step, and writes it if there is a folder.

    ``processor``: this rank's seconds of work before the first step, compilation left out.
    ``earlier``: the record of the run that this one goes on with; its steps stay, its seconds
    count. A context: leaving it first notes an interruption or a failure.

    The checkpoint is written first: a step that is in it is never lost.
    """

    def __init__(
        self,
        record: dict[str, Any],
        stepper: Stepper,
        folder: Folder | None,
        checkpoint: Writer | None,
        seconds: dict[str, float],
        began: float,
        processor: float,
        earlier: Mapping[str, Any] | None = None,
    ) -> None:
        self.record, self._stepper, self._folder = record, stepper, folder
        self._problem, self._seconds, self._began = stepper.problem, seconds, began
        self._checkpoint, self._processor = checkpoint, processor
        self._earlier = earlier or {}
        self._fields: Fields | None = None
        if earlier is not None:
            record |= {key: value for key, value in earlier.items() if key not in record}
            record["steps"] = list(earlier["steps"])
            record["resumed"] = [*earlier.get("resumed", []), self._problem.load]
        elif folder:
            folder.clear()
        if folder:
            until = self._problem.load if earlier is not None else None
            self._fields = Fields(folder.path / "fields.pvd", self._problem, until)
        self._output = 0.0

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: Any, *_: Any) -> None:
        # After an interruption the other ranks may be anywhere: nothing collective then.
        if kind is not None and self._problem.comm.rank == 0:
            status = "interrupted" if kind is KeyboardInterrupt else f"failed: {one_line(error)}"
            with suppress(BadInput):  # the disk may be full: that is what we are told already
                self._write(status)

    def step(self, row: dict[str, Any]) -> None:
        """Add a step's row; its state if it converged. Collective."""
        self.record["steps"].append(row)
        self.keep("running", state=row["converged"])

    def modes(self, modes: Modes) -> None:
        """Add the eigenfrequencies, and write their shapes. Collective."""
        start = perf_counter()
        self.record["modes"] = modes.record
        self._seconds = self._seconds | {"modes": modes.seconds}
        if self._folder:
            write_modes(self._folder.path / "modes.pvd", modes)
        self._output += perf_counter() - start

    def keep(self, status: str, state: bool = False) -> None:
        """Write everything as it is now, the ``state`` if asked. Collective.

        BadInput on every rank if one cannot.
        """
        start = perf_counter()
        comm = self._problem.comm
        # ru_maxrss is in KiB.
        peak = comm.allreduce(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024)
        self.record["peak_memory_mb"] = max(peak, self._earlier.get("peak_memory_mb", 0.0))
        worked = comm.allreduce(self._processor + self._stepper.processor)
        worked += self._earlier.get("processor_seconds", 0.0)
        self.record["processor_seconds"] = worked
        self._describe(status)
        if self._checkpoint and state:
            self._checkpoint.write(self.record)
        if self._fields and state:
            self._fields.write(self._problem)
        self._output += perf_counter() - start
        on_root(comm, self._write, status)

    def _describe(self, status: str) -> None:
        """Bring status and seconds up to date."""
        assemble = self._problem.seconds["assemble"]
        self.record["status"] = status
        self.record["converged"] = status == "converged"
        seconds = self._seconds | {
            "assemble": assemble,
            "solve": self._stepper.seconds - assemble,
            "output": self._output,
            "total": perf_counter() - self._began,
        }
        before = self._earlier.get("seconds", {})
        self.record["seconds"] = {key: v + before.get(key, 0.0) for key, v in seconds.items()}

    def _write(self, status: str) -> None:
        now = perf_counter()
        self._describe(status)
        if self._folder:
            self._folder.write(self.record)
            self._output += perf_counter() - now


def one_line(error: BaseException) -> str:
    """What an error says, or what it is."""
    return " ".join(str(error).split()) or type(error).__name__
