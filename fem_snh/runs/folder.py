"""A run's folder: run.json and steps.csv, atomically; fields.pvd with its pieces."""

from __future__ import annotations

import csv
import io
import json
import os
import platform
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.errors import BadInput, on_root
from fem_snh.modes import Modes
from fem_snh.problem import Problem
from fem_snh.scenes import Scene

COLUMNS = (
    "load", "converged", "reason", "newton", "clamped", "linear", "residual", "energy",
    "volume_ratio", "min_J", "max_u", "nonfinite", "seconds",
)  # fmt: skip
MODE_COLUMNS = ("mode", "frequency", "residual")


def describe(scene: Scene, problem: Problem, snes: PETSc.SNES) -> dict[str, Any]:
    """run.json's content before the first step. Collective."""
    law = problem.material.law
    mu, lam = problem.material.lame
    own = {str(c): v for c, v in zip(law.constants, law.values, strict=True)}
    return {
        "scene": scene.name,
        "material": {
            "name": law.name,
            "E": law.E,
            "nu": law.nu,
            "mu_lame": mu,
            "lambda_lame": lam,
            "parameters": own | law.shape,
        },
        "element": scene.element,
        "quadrature": problem.element.quadrature,
        "hessian": scene.hessian,
        "eigensolver": problem.eigensolver,
        "terms": [term.name for term in problem.terms],
        "cells": problem.mesh.num_cells,
        "dofs": problem.dofs,
        "ranks": problem.comm.size,
        "load_name": scene.load_name,
        "load_range": list(scene.load_range),
        "linear_solver": f"{snes.getKSP().getType()}+{snes.getKSP().getPC().getType()}",
        "tolerance": snes.getPythonContext().options["snes_scaled_tol"] * problem.force_scale,
        "converged": False,
        "status": "running",
        "steps": [],
        "seconds": {},
        "peak_memory_mb": 0.0,
        "versions": {
            "fem_snh": _version(),
            "dolfinx": _dolfinx.version,
            "petsc": ".".join(map(str, PETSc.Sys.getVersion())),
            "python": platform.python_version(),
        },
    }


class Folder:
    """Makes or reuses ``path``; BadInput on every rank if it cannot. Rank 0 writes. Collective."""

    def __init__(self, comm: MPI.Comm, path: Path, overwrite: bool) -> None:
        self.comm, self.path = comm, path
        on_root(comm, self._check, overwrite)

    def _check(self, overwrite: bool) -> None:
        if (self.path / "run.json").exists() and not overwrite:
            raise BadInput(f"{self.path} already holds a run: give --overwrite or another --out")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            raise BadInput(
                f"output folder {self.path} cannot be written ({error.strerror}): choose another"
            ) from None

    def clear(self) -> None:
        """Remove an earlier run's files: when the new one is ready to begin. Collective."""
        if self.comm.rank == 0:
            for pattern in ("fields*.pvd", "fields*vtu", "modes*.pvd", "modes*vtu"):
                for file in self.path.glob(pattern):
                    file.unlink(missing_ok=True)
            for name in ("steps.csv", "modes.csv"):
                (self.path / name).unlink(missing_ok=True)
        self.comm.barrier()

    def write(self, record: dict[str, Any]) -> None:
        """Write run.json and steps.csv; each is old or new, never half. Not collective."""
        if self.comm.rank:
            return
        steps = [_flat(step) for step in record["steps"]]
        columns = dict.fromkeys([*COLUMNS, *(key for step in steps for key in step)])
        _replace(self.path / "steps.csv", _table(list(columns), steps))
        if "modes" in record:
            modes = record["modes"]
            numbered = enumerate(zip(modes["frequencies"], modes["residuals"], strict=True), 1)
            rows = [dict(zip(MODE_COLUMNS, (i, *values), strict=True)) for i, values in numbered]
            _replace(self.path / "modes.csv", _table(MODE_COLUMNS, rows))
        _replace(self.path / "run.json", json.dumps(_plain(record), indent=1) + "\n")


class Fields:
    """Writes displacement, J, energy density and smallest eigenvalue to a .pvd. Collective.

    And the pressure [Pa], if it is unknown, at the nodes of the displacement.
    """

    def __init__(self, path: Path, problem: Problem) -> None:
        constant = _dolfinx.function_space(problem.mesh.domain, 0, family="DG")
        names = ["J", *(["energy_density"] if problem.has_energy else []), "min_eigenvalue"]
        self._cellwise = {name: _dolfinx.function(constant, name) for name in names}
        self._dofs = _dolfinx.node_dofs(constant)[:, 0]
        self._nodal = [problem.u]
        if problem.saddle:
            self._pressure = _dolfinx.function(problem.saddle.Q, "pressure")
            scalars = _dolfinx.function_space(problem.mesh.domain, problem.element.degree)
            self._nodal.append(_dolfinx.function(scalars, "pressure"))
        self._open = _dolfinx.vtk_writer(problem.comm, path)
        self._writer = self._open.__enter__()

    def write(self, problem: Problem) -> None:
        """Append the present state, at time = load. J and energy are means over each cell."""
        fields = problem.fields(problem.x)
        values = {
            "J": fields["deformed_volume"] / fields["volume"],
            "energy_density": fields["energy"] / fields["volume"],
            "min_eigenvalue": fields["min_eigenvalue"],
        }
        for name, function in self._cellwise.items():
            function.x.array[self._dofs] = values[name]
        if problem.saddle:
            self._pressure.x.array[:] = problem.saddle.pressure()
            self._nodal[1].interpolate(self._pressure)
        self._writer.write([*self._nodal, *self._cellwise.values()], problem.load)

    def close(self) -> None:
        self._open.__exit__(None, None, None)


def write_modes(path: Path, modes: Modes) -> None:
    """Write the shapes to a .pvd, at times 1, 2, ..., each with the state it is about. Collective.

    ``mode`` [m] is scaled so that its mean square over the body's mass is ``length`` squared.
    """
    problem = modes.problem
    shape = _dolfinx.function(problem.V, "mode")
    with _dolfinx.vtk_writer(problem.comm, path) as writer:
        for number, vector in enumerate(modes.shapes, 1):
            x = _dolfinx.petsc_vec(shape)
            vector.copy(x)
            x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
            writer.write([problem.u, shape], float(number))


def _flat(step: dict[str, Any]) -> dict[str, Any]:
    """A step as a row of the table: a column for each component of each reaction and probe."""
    row = {key: value for key, value in step.items() if key not in ("reactions", "probes")}
    for kind in ("reaction", "probe"):
        for name, vector in step.get(f"{kind}s", {}).items():
            row |= {f"{kind}_{name}_{axis}": v for axis, v in zip("xyz", vector, strict=True)}
    return row


def _table(columns: Sequence[str], rows: list[dict[str, Any]]) -> str:
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()


def _replace(path: Path, text: str) -> None:
    """Write a file beside ``path`` and move it there in one step."""
    new = path.with_name(f".{path.name}.new")
    new.write_text(text)
    os.replace(new, path)


def _plain(value: Any) -> Any:
    """JSON has no infinity or NaN: they become null; numpy numbers become Python's."""
    if isinstance(value, dict):
        return {key: _plain(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("fem_snh")
    except PackageNotFoundError:
        return "unknown"
