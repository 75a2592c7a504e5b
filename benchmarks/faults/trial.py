"""A disturbed run, the run that resumes it, and the comparison with an undisturbed run."""

from __future__ import annotations

import functools
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import Row, search_path
from benchmarks.faults.intervention import CONVERGED_STEPS
from fem_snh.runs import checkpoint as checkpoint_file
from fem_snh.runs.output import nodal_values
from fem_snh.studies.points import measured_columns, read_record
from fem_snh.studies.tasks import Child, program

#: With stresses, the fields of a step are larger than the checkpoint.
FIELDS = '--set=fields=["cauchy_stress"]'
#: A small run of many short steps.
SCENE = ("stretch", "--cells=6", "--steps=30", "--set=stretch=2.0", FIELDS)
#: A tolerance so small that the displacements of two runs can be compared.
PETSC = ("-snes_scaled_tol", "1e-10")
#: Largest difference of two displacements that count as equal, over the extent of the body.
AGREEMENT = 1e-9
#: Seconds after which a run counts as hanging.
_TIMEOUT = 180.0


@dataclass
class Trial:
    """A run in ``out`` (default: folder/run) and the logs of all runs that resume it.

    Attributes
    ----------
    folder : Path
        Where the logs are written.
    seconds : float
        Total time of its runs so far.
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
        """Start or resume the run on ``ranks`` ranks.

        Parameters
        ----------
        *petsc : str
            Further PETSc options.
        module : str
            The module to run, which takes the arguments of fem-snh.
        """
        self._logs.append(self.folder / f"log{len(self._logs)}.txt")
        arguments = ["run", *SCENE, "--out", str(self.out), *(["--resume"] if resume else [])]
        command = [*program(ranks, module), *arguments, "--", *PETSC, *petsc]
        return Child(command, self._logs[-1], _TIMEOUT, variables=search_path())

    def start_paused(self, ranks: int) -> Child:
        """Start the run and return when it is paused in step `CONVERGED_STEPS` + 1.

        Raises
        ------
        RuntimeError
            If the run ends before that step.
        """
        child = self.start(ranks, module="benchmarks.faults.pause")
        while len(self.converged_steps()) < CONVERGED_STEPS:
            if child.poll() is not None:
                raise RuntimeError(f"the run ended before it could be paused: {self.log()[-500:]}")
            time.sleep(0.01)
        return child

    def wait(self, child: Child) -> int:
        """Wait for the end of the run and return its exit code."""
        while (code := child.poll()) is None:
            time.sleep(0.002)
        self.seconds += child.seconds
        return code

    def converged_steps(self) -> list[dict[str, Any]]:
        """Return the converged steps that run.json holds."""
        return [step for step in read_record(self.out).get("steps", []) if step["converged"]]

    def result(self, code: int | None) -> dict[str, Any]:
        """Return the result of the last run, as the measured columns of a study's table."""
        return measured_columns(read_record(self.out), self._logs[-1], code or 0)

    def log(self) -> str:
        """Return the output of the last run."""
        return self._logs[-1].read_text(errors="replace")


def resume_and_compare(trial: Trial, code: int | None, expected: str, kept: int, ranks: int) -> Row:
    """Resume a run that has failed with exit code ``code`` and return the row of its fault.

    The row is ``ok`` if the disturbed run failed with the ``expected`` message and no traceback,
    had at least ``kept`` converged steps, the resumed run (on ``ranks`` ranks) keeps those steps,
    and its final displacement is that of the undisturbed run.
    """
    log = trial.log()
    lines = [str(trial.result(code)["status"]), *log.splitlines()]
    status = next((line.strip() for line in lines if expected in line), lines[0])
    before = trial.converged_steps()
    row = compare_with_undisturbed(trial, trial.wait(trial.start(ranks, resume=True)))
    after = trial.converged_steps()[: len(before)]
    row["ok"] = (
        row["ok"]
        and code not in (0, None)
        and expected in status
        and "Traceback" not in log
        and len(before) >= kept
        and after == before
    )
    return row | {"status": status, "exit_code": code, "kept": len(before)}


def compare_with_undisturbed(trial: Trial, code: int | None) -> Row:
    """Return the row of a run that has ended: ``ok`` if its result is the undisturbed run's."""
    result = trial.result(code)
    gap = difference(trial.out, undisturbed()) if result["converged"] else float("nan")
    return {
        "ok": bool(result["converged"] and gap <= AGREEMENT),
        "status": result["status"],
        "newton": result["newton"],
        "linear": result["linear"],
        "seconds": trial.seconds,
        "difference": gap,
    }


@functools.cache
def undisturbed() -> Path:
    """Run the scene once without a fault and return its folder."""
    _folders.append(tempfile.TemporaryDirectory())
    trial = Trial(Path(_folders[-1].name))
    code = trial.wait(trial.start(1))
    if code != 0:
        raise RuntimeError(f"the undisturbed run failed: {trial.log()[-500:]}")
    return trial.out


#: Keeps the folder of the undisturbed run until the program ends.
_folders: list[tempfile.TemporaryDirectory[str]] = []


def difference(one: Path, other: Path) -> float:
    """Return max ``|u - u'|`` over the extent of the body, at the last steps of two runs."""
    (_, a), (_, b) = checkpoint_file.load(one), checkpoint_file.load(other)
    order = nodal_values.match_nodes(a["u_nodes"], b["u_nodes"])
    extent = float(np.ptp(a["u_nodes"], axis=0).max())
    return float(np.abs(a["u"] - b["u"][order]).max()) / extent
