"""A case of the study: its run, its acceptance criterion, and whether it must pass."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from fem_snh import scenes
from fem_snh.choices import HESSIANS
from fem_snh.studies.point import Point
from fem_snh.studies.scene_points import ScenePoint
from fem_snh.studies.table import MEASURED, REQUESTED

#: The record of a case (empty if there is none) and its row.
Record = Mapping[str, Any]
Row = Mapping[str, Any]
#: Returns why a case fails its criterion, or "" if it passes.
Check = Callable[[Record, Row], str]

#: Values of the column ``expected``. Cases that may fail are run for comparison.
PASS, MAY_FAIL = "pass", "may fail"

#: Hessian and globalization of each policy, by the word for both in a case's name.
POLICIES = {h: {"hessian": h, "globalization": "linesearch"} for h in HESSIANS}
POLICIES["trust"] = {"hessian": "adaptive", "globalization": "trust_region"}

#: Columns of the table.
COLUMNS = (
    "point", "family", "criterion", "expected", "passed", "reason",
    *REQUESTED, "seed", "ranks", *MEASURED, "max_u", "nonfinite", "difference",
)  # fmt: skip

#: Timeout of a case that may fail [s].
_MAY_FAIL_TIMEOUT = 200.0
#: Largest displacement at which a unit cube counts as being at rest.
REST_TOLERANCE = 1e-6
#: The criterion of `ends_clearly`, in words.
CLEAR = "converges, or says why not and keeps its steps"


@dataclass(frozen=True)
class Case:
    """One row of the study.

    Parameters
    ----------
    name : str
        Name of its folder: unique, with its family first.
    point : Point
        The run.
    check : Check
        Evaluates its acceptance criterion.
    required : bool
        Whether the study fails if this case fails.
    refused : bool
        Whether it is meant to end without a record.
    """

    name: str
    point: Point
    check: Check
    required: bool = True
    refused: bool = False

    @property
    def family(self) -> str:
        """The family that the case belongs to."""
        return self.name.partition("-")[0]

    def evaluate(self, record: Record, row: Row) -> dict[str, Any]:
        """Evaluate the acceptance criterion; return the columns ``passed`` and ``reason``."""
        checked = record or self.refused
        reason = self.check(record, row) if checked else str(row["status"])
        remark = ""
        if reason:
            remark = "failed" if self.required else "failed, as it may"
            remark += "" if reason == row["status"] else f": {reason}"
        return {"passed": not reason, "reason": reason, "remark": remark}


def scene_case(
    scene: str,
    name: str,
    criterion: str,
    check: Check,
    material: str = "",
    required: bool = True,
    **values: Any,
) -> Case:
    """Return a case that runs a scene with keyword arguments of `fem_snh.scenes.load`.

    With a ``material`` it is not required: the theory is that of Stable Neo-Hookean.
    """
    required = required and not material
    values |= {"material": material} if material else {}
    family, seed = name.partition("-")[0], values.get("seed")
    columns = case_columns(family, criterion, required) | {"seed": seed}
    loaded = _load_scene(scene, json.dumps({k: v for k, v in values.items() if k != "seed"}))
    timeout = None if required else _MAY_FAIL_TIMEOUT
    point = ScenePoint(scene, values, loaded, columns=columns, timeout=timeout)
    return Case(name, point, check, required)


def case_columns(family: str, criterion: str, required: bool) -> dict[str, Any]:
    """Return the columns of a case that are known before it runs."""
    expected = PASS if required else MAY_FAIL
    return {"family": family, "criterion": criterion, "expected": expected}


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
