"""A tight solve of a case, from the state that the case ended in: does it contradict the case?

It has sparse factors and a tolerance of `_TOLERANCE`. A state that is an equilibrium stays where it
is; one that was taken for an equilibrium moves. The tight solve does not leave another equilibrium
of the same load either, so it does not tell which one the case should have found.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.extremes.cases import Case, Record, Row
from fem_snh.studies.points import read_record

#: The tight solve's tolerance of forces relative to E V^(2/3); the default one is 1e-7.
_TOLERANCE = 1e-9
_PETSC = {"snes_scaled_tol": _TOLERANCE, "snes_linear_solver": "direct"}
#: Largest relative difference of a converged result from the tight one.
AGREES = 0.01
#: Displacements over the body's length, forces over E L^2 and energies over E L^3 below which
#: differences are none: what rounding leaves of a body at rest.
_REST = {"u": 1e-10, "force": 1e-10, "energy": 1e-18}


def tight_row(case: Case, out: Path) -> dict[str, Any]:
    """Solve a case that has converged in ``out`` again, and return the row of that solve.

    Its column ``difference`` is the difference from the case.
    """
    kind, _, element = case.name.rpartition("-")
    values = {**case.values, "steps": 1}
    if not case.values.get("friction"):  # its history begins with the run
        values["start.run"] = str(out / case.name)
    tight = replace(
        case, name=f"{kind}-tight-{element}", values=values, petsc=_PETSC, check=agrees,
        criterion=f"a tight solve differs by at most {AGREES:.0%}",
    )  # fmt: skip
    record, row = tight.run(out)
    if row["converged"]:
        before = out / case.name
        row["difference"] = difference(before, read_record(before), out / tight.name, record)
    return row | tight.verdict(record, row)


def agrees(record: Record, row: Row) -> str:
    """Check that the tight solve leaves the state of the case where it is."""
    if row["converged"] is not True:
        return f"the tight solve fails: {row['status']}"
    return (
        "" if row["difference"] <= AGREES else f"the tight solve differs by {row['difference']:.2g}"
    )


def difference(
    folder: Path, record: Mapping[str, Any], tight_folder: Path, tight: Mapping[str, Any]
) -> float:
    """Return the largest relative difference of two runs in displacements, forces and energy."""
    from fem_snh.viewing.states import States, displacement_at

    states = States(folder / "fields.pvd")
    points = np.asarray(states.mesh.points, dtype=float)
    length = float(np.ptp(points, axis=0).max())
    kinematics = record.get("kinematics")
    u = [displacement_at(run, -1, kinematics, points)[0] for run in (folder, tight_folder)]
    size = max(np.abs(u[1]).max(), _REST["u"] * length)
    found = [float(np.abs(u[0] - u[1]).max() / size)]
    ends = [[s for s in run["steps"] if s["converged"]][-1] for run in (record, tight)]
    E = float(_modulus(record))
    units = {"force": E * length**2, "energy": E * length**3}
    energies = [end["energy"] for end in ends]
    if None not in energies:  # friction has none
        found.append(_relative(energies, _REST["energy"] * units["energy"]))
    # Of a body under a torque the forces are rounding: they are compared with the largest of all.
    forces = [_forces(end, length) for end in ends]
    largest = max((np.abs(force).max() for force in forces[1]), default=0.0)
    least = max(largest, _REST["force"] * units["force"])
    found += [_relative(pair, least) for pair in zip(*forces, strict=True)]
    return max(found)


def _forces(end: Mapping[str, Any], length: float) -> list[Any]:
    """Return the reactions of a step, their moments over a length, and the obstacles' forces."""
    moments = [np.asarray(m) / length for m in end.get("moments", {}).values()]
    obstacles = [row["force"] for row in end.get("obstacles", {}).values()]
    return [*end.get("reactions", {}).values(), *moments, *obstacles]


def _relative(values: Any, least: float) -> float:
    """Return the difference of two numbers or vectors relative to the second."""
    first, second = (np.asarray(v, dtype=float) for v in values)
    return float(np.abs(first - second).max() / max(np.abs(second).max(), least))


def _modulus(record: Mapping[str, Any]) -> float:
    """Return the smallest modulus of a run's materials [Pa]."""
    materials = record["material"]
    return min(m["E"] for m in (materials if isinstance(materials, list) else [materials]))
