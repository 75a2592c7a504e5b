"""Keeps run.json, steps.csv and the fields up to date while a run goes on."""

from __future__ import annotations

import resource
from time import perf_counter
from typing import Any

from fem_snh.modes import Modes
from fem_snh.runs.folder import Fields, Folder, write_modes
from fem_snh.runs.stepping import Stepper


class Recorder:
    """Brings ``record`` up to date after every step, and writes it if there is a folder.

    ``processor``: this rank's seconds of work before the first step, compilation left out.
    A context: leaving it closes the fields, and first notes an interruption or a failure.
    """

    def __init__(
        self,
        record: dict[str, Any],
        stepper: Stepper,
        folder: Folder | None,
        seconds: dict[str, float],
        began: float,
        processor: float,
    ) -> None:
        self.record, self._stepper, self._folder = record, stepper, folder
        self._problem, self._seconds, self._began = stepper.problem, seconds, began
        self._processor = processor
        if folder:
            folder.clear()
        self._fields = Fields(folder.path / "fields.pvd", self._problem) if folder else None
        self._output = 0.0

    def __enter__(self) -> Recorder:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: Any, *_: Any) -> None:
        # After an interruption the other ranks may be anywhere: nothing collective then.
        if kind is not None and self._problem.comm.rank == 0:
            self._write("interrupted" if kind is KeyboardInterrupt else f"failed: {error}")
        if self._fields:
            self._fields.close()

    def step(self, row: dict[str, Any]) -> None:
        """Add a step's row; its fields if it converged. Collective."""
        self.record["steps"].append(row)
        self.keep("running", fields=row["converged"])

    def modes(self, modes: Modes) -> None:
        """Add the eigenfrequencies, and write their shapes. Collective."""
        start = perf_counter()
        self.record["modes"] = modes.record
        self._seconds = self._seconds | {"modes": modes.seconds}
        if self._folder:
            write_modes(self._folder.path / "modes.pvd", modes)
        self._output += perf_counter() - start

    def keep(self, status: str, fields: bool = False) -> None:
        """Write everything as it is now. Collective."""
        start = perf_counter()
        if self._fields and fields:
            self._fields.write(self._problem)
        # ru_maxrss is in KiB.
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        self.record["peak_memory_mb"] = self._problem.comm.allreduce(peak)
        worked = self._processor + self._stepper.processor
        self.record["processor_seconds"] = self._problem.comm.allreduce(worked)
        self._output += perf_counter() - start
        self._write(status)

    def _write(self, status: str) -> None:
        now, assemble = perf_counter(), self._problem.seconds["assemble"]
        self.record["status"] = status
        self.record["converged"] = status == "converged"
        self.record["seconds"] = self._seconds | {
            "assemble": assemble,
            "solve": self._stepper.seconds - assemble,
            "output": self._output,
            "total": now - self._began,
        }
        if self._folder:
            self._folder.write(self.record)
            self._output += perf_counter() - now
