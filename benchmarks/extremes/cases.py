"""A case: its run, its acceptance criterion, and whether it must pass."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from fem_snh import scenes
from fem_snh.choices import HESSIANS
from fem_snh.studies.points import (
    MEASURED,
    REQUESTED,
    measured_columns,
    read_record,
    requested_columns,
    run_arguments,
)
from fem_snh.studies.tasks import Child, program

#: The record of a case (empty if there is none) and its row.
Record = Mapping[str, Any]
Row = Mapping[str, Any]
#: Returns why a case fails its criterion, or "" if it passes.
Check = Callable[[Record, Row], str]

#: Values of the column ``expected``. Cases that may fail are run for comparison.
PASS, MAY_FAIL = "pass", "may fail"

#: Hessian and globalization of each policy, by the word for both in a case's name.
POLICIES: dict[str, dict[str, Any]] = {
    h: {"hessian": h, "globalization": "linesearch"} for h in HESSIANS
}
POLICIES["trust"] = {"hessian": "adaptive", "globalization": "trust_region"}

#: Columns of the table.
COLUMNS = (
    "case", "family", "criterion", "expected", "passed", "reason",
    *REQUESTED, "seed", *MEASURED, "max_u", "nonfinite", "difference",
)  # fmt: skip

#: Timeouts of cases that must pass and of cases that may fail [s]; memory of each [GiB].
_TIMEOUT, _MAY_FAIL_TIMEOUT, _MEMORY = 900.0, 200.0, 3.0
#: Seconds between two polls of a run.
_POLL_INTERVAL = 0.01
#: Largest displacement at which a unit cube counts as being at rest.
REST_TOLERANCE = 1e-6
#: The criterion of `ends_clearly`, in words.
CLEAR = "converges, or says why not and keeps its steps"


@dataclass(frozen=True)
class Case:
    """A run of a scene, and what it must fulfil.

    Parameters
    ----------
    name : str
        Unique; its family comes first.
    scene : str
        Name of the scene, or ``FILE.py:FUNCTION``.
    values : mapping
        Keyword arguments of `fem_snh.scenes.load`.
    criterion : str
        The acceptance criterion, in words.
    check : Check
        Evaluates the criterion.
    required : bool
        Whether it must pass; the others are run for comparison.
    refused : bool
        Whether it is meant to end without a record.
    tight : bool
        Whether a tight solve follows; the name ends with the element.
    petsc : mapping
        PETSc options, without the dash.
    """

    name: str
    scene: str
    values: Mapping[str, Any]
    criterion: str
    check: Check
    required: bool = True
    refused: bool = False
    tight: bool = False
    petsc: Mapping[str, Any] = field(default_factory=dict)

    @property
    def family(self) -> str:
        """The family that the case belongs to."""
        return self.name.partition("-")[0]

    @property
    def loaded(self) -> scenes.Scene:
        """The scene with the values."""
        values = {key: v for key, v in self.values.items() if key != "seed"}
        return _load_scene(self.scene, json.dumps(values))

    def run(self, out: Path, timeout: float | None = None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Run it in a process, in a folder of its name in ``out``; return its record and row."""
        log = out / f"{self.name}.txt"
        arguments = run_arguments(self.scene, out / self.name, self.values, self.petsc)
        limit = timeout or (_TIMEOUT if self.required else _MAY_FAIL_TIMEOUT)
        child = Child([*program(1), *arguments], log, limit, _MEMORY)
        try:
            while (code := child.poll()) is None:
                time.sleep(_POLL_INTERVAL)
        except BaseException:
            child.end()
            raise
        record = read_record(out / self.name)
        row = {
            "case": self.name, "family": self.family, "criterion": self.criterion,
            "expected": PASS if self.required else MAY_FAIL, "seed": self.values.get("seed"),
            **requested_columns(self.loaded), **measured_columns(record, log, code),
        }  # fmt: skip
        row["seconds"] = row["seconds"] or child.seconds
        if child.limit_reached:
            row |= {"converged": False, "status": child.limit_reached}
        return record, row

    def verdict(self, record: Record, row: Row) -> dict[str, Any]:
        """Evaluate the acceptance criterion; return the columns ``passed`` and ``reason``."""
        checked = record or self.refused
        reason = self.check(record, row) if checked else str(row["status"])
        return {"passed": not reason, "reason": reason}


def scene_case(
    scene: str,
    name: str,
    criterion: str,
    check: Check,
    required: bool = True,
    *,
    tight: bool = False,
    **values: Any,
) -> Case:
    """Return a case that runs a scene with keyword arguments of `fem_snh.scenes.load`."""
    return Case(name, scene, values, criterion, check, required, tight=tight)


@cache
def _load_scene(scene: str, values: str) -> scenes.Scene:
    """Return a scene for the columns of its row; cached, as no column depends on the seed."""
    return scenes.load(scene, **json.loads(values))


def converged(record: Record, row: Row) -> str:
    """Check that the run reached load 1 in the number of steps asked for."""
    if row["converged"] is not True:
        return str(row["status"])
    attempted = len(record["steps"])
    return f"{attempted} steps instead of {row['steps']}" if attempted > row["steps"] else ""


def at_rest(record: Record, row: Row) -> str:
    """Check that every point of a unit cube is within `REST_TOLERANCE` of its rest position."""
    reason = converged(record, row)
    if reason or row["max_u"] < REST_TOLERANCE:
        return reason
    return (
        f"another equilibrium: max |u| {row['max_u']:.2g}, energy {row['energy']:.2g}, "
        f"min J {row['min_J']:.2f}"
    )


def ends_clearly(record: Record, row: Row) -> str:
    """Check that a run converged, or stopped with a reason and the steps that it has solved."""
    if row["converged"] is True:
        return ""
    status = str(row["status"])
    if not status.startswith("stopped at "):
        return status  # a crash, a timeout, an error
    solved = [step["load"] for step in record["steps"] if step["converged"]]
    if not record["steps"] or "(" not in status:
        return f"no reason: {status}"
    reached = float(status.removeprefix("stopped at load ").partition(":")[0])
    last = max(solved, default=0.0)
    return "" if abs(reached - last) < 1e-9 else f"{status}, but the last step is at load {last:g}"
