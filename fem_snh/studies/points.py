"""A point of a study: a run of a scene by ``fem-snh run``, and its row of the table."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.records.run_record import load_record, results

#: Columns of the settings of a run.
REQUESTED = "scene material E nu element cells hessian globalization predictor steps".split()
#: Columns of the results of a run.
MEASURED = (
    "converged status notes load newton clamped linear energy volume_ratio min_J residual "
    "seconds num_cells dofs"
).split()
#: The column of the estimated error, which tables of scenes with an estimate have.
ERROR = "error"
#: The value in the column ``notes`` of a run without notes.
NO_NOTES = "none"


def run_arguments(
    scene: str | Path, folder: Path | None, values: Mapping[str, Any], petsc: Mapping[str, Any]
) -> list[str]:
    """Return the arguments of ``fem-snh`` for a run with these values and PETSc options.

    Without a folder the run writes nothing.
    """
    arguments = ["run", str(scene), "--quiet"]
    arguments += ["--out", str(folder), "--overwrite"] if folder is not None else []
    arguments += [f"--set={key}={json.dumps(v)}" for key, v in values.items()]
    options = [[f"-{k}"] if v is None else [f"-{k}", value_text(v)] for k, v in petsc.items()]
    return [*arguments, "--", *itertools.chain(*options)]


def value_text(value: Any) -> str:
    """Return a value as it is written on the command line."""
    return value if isinstance(value, str) else json.dumps(value)


def requested_columns(scene: scenes.Scene) -> dict[str, Any]:
    """Return the settings of a scene as the columns REQUESTED."""
    values = {key: value for key, value in scene if key in REQUESTED}
    materials = scene.materials
    name, E, nu = (
        _joined(each) for each in zip(*((m.name, m.E, m.nu) for m in materials), strict=True)
    )
    return values | {"scene": scene.name, "material": name, "E": E, "nu": nu}


def _joined(values: Sequence[Any]) -> Any:
    """Return a single value itself, or several as a text such as "0.3 + 0.5"."""
    if len(values) == 1:
        return values[0]
    return " + ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def read_record(folder: Path) -> dict[str, Any]:
    """Return the run.json in a point's folder; empty if it is missing or damaged."""
    try:
        return load_record(folder / "run.json")
    except BadInput:
        return {}


def measured_columns(record: Mapping[str, Any], log: Path, code: int) -> dict[str, Any]:
    """Return the results of a run: the columns MEASURED, ``nonfinite``, ``max_u`` and `results`.

    ``notes`` has the kinds of the notes, with spaces between.

    Iterations are summed over all steps, converged or not; energy, volume and the other state
    variables are those of the last converged step. ``seconds`` excludes the compilation, and also
    the error estimate unless the run refines its mesh by the estimate. ``error`` is
    `largest_error`.

    Parameters
    ----------
    record : mapping
        The run's run.json; empty if there is none.
    log : Path
        The file of the run's output.
    code : int
        The run's exit code.
    """
    steps = record.get("steps", [])
    converged = [step for step in steps if step.get("converged")]
    summed = ("newton", "clamped", "linear", "nonfinite")
    last = ("load", "energy", "volume_ratio", "min_J", "residual", "max_u")
    row: dict[str, Any] = {key: sum(step.get(key) or 0 for step in steps) for key in summed}
    row |= {key: converged[-1].get(key) for key in last if converged}
    row |= results(converged[-1]) if converged else {}
    # Not empty: pandas would read a missing value.
    row["notes"] = " ".join(note["kind"] for note in record.get("notes", ())) or NO_NOTES
    row["converged"] = code == 0 and record.get("converged") is True
    row["status"] = (code in (0, 1) and record.get("status")) or failure_message(log, code)
    row |= {"num_cells": record.get("cells"), "dofs": record.get("dofs"), "seconds": None}
    if "total" in (seconds := record.get("seconds", {})):
        without = ("jit",) if "accuracy" in record else ("jit", "estimate")
        row["seconds"] = seconds["total"] - sum(seconds.get(key, 0.0) for key in without)
    row[ERROR] = largest_error(record)
    # The defaults, if the scene names none.
    row |= {key: record[key] for key in ("hessian", "globalization") if key in record}
    return row


def largest_error(record: Mapping[str, Any]) -> float | None:
    """Return the largest relative error of a run's goals; None without an estimate.

    Errors of components are relative to the largest component. Where the bound of a corrected value
    is more than the error that was added, it is added to that. A vector that is rounding is left
    out.
    """
    vectors: dict[str, list[Mapping[str, Any]]] = {}
    for name, goal in record.get("goals", {}).items():
        if goal.get("error") is not None:
            vectors.setdefault(re.sub(r"\.[xyz]$", "", name), []).append(goal)
    ratios = [
        max(map(_size, goals)) / max(abs(goal["value"]) for goal in goals)
        for goals in vectors.values()
        if any(goal.get("relative") is not None for goal in goals)
    ]
    return max(ratios, default=None)


def _size(goal: Mapping[str, Any]) -> float:
    """Return the size of the error of a goal's value."""
    error, bound = abs(goal["error"]), goal.get("bound") or 0.0
    return float(error + bound if bound > error else error)


def failure_message(log: Path, code: int) -> str:
    """Return why a point failed, from its log: its error message, or its last line."""
    reason = f"ended by signal {-code}" if code < 0 else f"exit code {code}"
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    errors = [line for line in lines if "fem-snh: error: " in line]
    if errors:
        return errors[-1].partition("fem-snh: error: ")[2]
    return f"{reason}: {lines[-1][:200]}" if lines else reason
