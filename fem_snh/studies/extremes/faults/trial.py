"""A run that something happens to, the run that goes on with it, and what came of both."""

from __future__ import annotations

import functools
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from fem_snh.runs import checkpoint, nodal_values
from fem_snh.studies.extremes.faults.disturbed import DONE
from fem_snh.studies.processes import Child, program
from fem_snh.studies.table import found, read_record

#: A small run of many short steps, whose equilibria are found to the last digits, so that those of
#: two runs can be compared.
SCENE = ("stretch", "--cells=6", "--steps=30", "--set=stretch=2.0")
PETSC = ("-snes_scaled_tol", "1e-10")
_HOLDING = "fem_snh.studies.extremes.faults.holding"
#: Displacements that agree: largest difference over the body's extent.
AGREE = 1e-9
#: Seconds after which a run hangs.
_LIMIT = 180.0


@dataclass
class Trial:
    """A run, in ``out`` (default: folder/run), and the logs of all that go on with it.

    Attributes
    ----------
    seconds : what its runs took so far.
    """

    folder: Path
    out: Path = Path()
    seconds: float = 0.0
    _logs: list[Path] = field(default_factory=list)

    def __post_init__(self) -> None:
        if self.out == Path():
            self.out = self.folder / "run"

    def start(
        self, ranks: int, *petsc: str, resume: bool = False, module: str = "fem_snh"
    ) -> Child:
        """Begin or resume the run on this many ranks.

        With more options of PETSc's, or by another program than fem-snh that takes its words.
        """
        self._logs.append(self.folder / f"log{len(self._logs)}.txt")
        words = ["run", *SCENE, "--out", str(self.out), *(["--resume"] if resume else [])]
        return Child(
            [*program(ranks, module), *words, "--", *PETSC, *petsc], self._logs[-1], _LIMIT
        )

    def held(self, ranks: int) -> Child:
        """Begin the run; when this returns it is in the middle of step `DONE` + 1, and stays there.

        Raises RuntimeError if it does not come that far.
        """
        child = self.start(ranks, module=_HOLDING)
        while len(self.finished()) < DONE:
            if child.poll() is not None:
                raise RuntimeError(f"it was to be held in a step, and ended: {self.said()[-500:]}")
            time.sleep(0.01)
        return child

    def wait(self, child: Child) -> int:
        """Wait for the end; the exit code."""
        while (code := child.poll()) is None:
            time.sleep(0.002)
        self.seconds += child.seconds
        return code

    def finished(self) -> list[dict[str, Any]]:
        """The steps that run.json says are done."""
        return [step for step in read_record(self.out).get("steps", []) if step["converged"]]

    def outcome(self, code: int | None) -> dict[str, Any]:
        """What the last run that was started says, as the columns of a study's row."""
        return found(read_record(self.out), self._logs[-1], code or 0)

    def said(self) -> str:
        """All that the last run that was started has printed."""
        return self._logs[-1].read_text(errors="replace")


def verdict(trial: Trial, code: int | None, expected: str, kept: int, ranks: int) -> dict[str, Any]:
    """The row of a fault, once what it happened to has ended with exit code ``code``.

    Resumes it on ``ranks``. It holds if it failed, and said what was ``expected``, and without a
    traceback; at least ``kept`` steps were done and still are; and the end is that of a run to
    which nothing happened.
    """
    said = trial.said()
    words = [str(trial.outcome(code)["status"]), *said.splitlines()]
    status = next((line.strip() for line in words if expected in line), words[0])
    before = trial.finished()
    row = ended(trial, trial.wait(trial.start(ranks, resume=True)))
    after = trial.finished()[: len(before)]
    row["holds"] = (
        row["holds"]
        and code not in (0, None)
        and expected in status
        and "Traceback" not in said
        and len(before) >= kept
        and after == before
    )
    return row | {"status": status, "exit_code": code, "kept": len(before)}


def ended(trial: Trial, code: int | None) -> dict[str, Any]:
    """The row of a run that came to its end: it holds if that is an undisturbed run's."""
    outcome = trial.outcome(code)
    gap = difference(trial.out, undisturbed()) if outcome["converged"] else float("nan")
    return {
        "holds": bool(outcome["converged"] and gap <= AGREE),
        "status": outcome["status"],
        "newton": outcome["newton"],
        "linear": outcome["linear"],
        "seconds": trial.seconds,
        "difference": gap,
    }


@functools.cache
def undisturbed() -> Path:
    """The folder of a run to which nothing happens."""
    _kept.append(tempfile.TemporaryDirectory())
    trial = Trial(Path(_kept[-1].name))
    code = trial.wait(trial.start(1))
    if code != 0:
        raise RuntimeError(f"the undisturbed run failed: {trial.said()[-500:]}")
    return trial.out


_kept: list[tempfile.TemporaryDirectory[str]] = []


def difference(one: Path, other: Path) -> float:
    """max |u - u'| over the body's extent, at the last steps of two runs."""
    (_, a), (_, b) = checkpoint.load(one), checkpoint.load(other)
    order = nodal_values.partners(a["u_nodes"], b["u_nodes"])
    extent = float(np.ptp(a["u_nodes"], axis=0).max())
    return float(np.abs(a["u"] - b["u"][order]).max()) / extent
