"""The output folder of a run: run.json and the tables, each replaced as a whole.

`fem_snh.runs.recorder` writes it after every step.
"""

from __future__ import annotations

import json
import platform
from pathlib import Path
from tempfile import TemporaryFile
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx, solver
from fem_snh.atomic_files import remove, replace_file
from fem_snh.errors import BadInput, on_root
from fem_snh.fem.problem import Problem
from fem_snh.fem.regions import Region
from fem_snh.runs.defaults import describe_defaults
from fem_snh.runs.tables import flat, table_text
from fem_snh.scenes import MaterialChoice, Scene

if TYPE_CHECKING:
    from fem_snh.runs.transient import Transient

#: Columns of steps.csv that every run has.
COLUMNS = (
    "load", "converged", "reason", "newton", "clamped", "linear", "lbfgs", "residual",
    "energy", "volume_ratio", "min_J", "max_u", "nonfinite", "seconds",
)  # fmt: skip
#: File name of the checkpoint.
CHECKPOINT = "checkpoint.npz"
#: Files of an earlier run, beside the tables and the checkpoint.
_OLD_FILES = (
    "fields*.pvd", "fields*vtu", "skin*.pvd", "skin*vtu", "modes*.pvd", "modes*vtu",
    "obstacles.pvd", "obstacles*vtu", "obstacle_*.stl", "bone_*.stl", "bone_*.obj",
)  # fmt: skip
#: Columns of modes.csv.
MODE_COLUMNS = ("mode", "frequency", "residual")


def describe(
    scene: Scene, problem: Problem, snes: PETSc.SNES, transient: Transient | None = None
) -> dict[str, Any]:
    """Return the content of run.json before the first step. Collective.

    Parameters
    ----------
    scene : Scene
        The scene.
    problem : Problem
        Its discretised problem.
    snes : PETSc.SNES
        Its nonlinear solver.
    transient : Transient, optional
        Its time integration.

    Returns
    -------
    dict
        The scene, its material, discretisation and solver, and no steps.
    """
    solver_options = snes.getPythonContext().options
    materials = [
        _describe_material(choice, region)
        for choice, region in zip(scene.materials, problem.regions, strict=True)
    ]
    notes = [note for term in problem.terms if (note := getattr(term, "note", ""))]
    return {
        "scene": scene.name,
        "material": materials[0] if len(materials) == 1 else materials,
        "element": scene.element,
        "quadrature": problem.element.quadrature,
        "hessian": solver_options["snes_hessian"],
        "globalization": solver_options["snes_globalization"],
        "eigensolver": problem.eigensolver,
        "assembly": problem.elastic.assembly,
        "terms": [term.name for term in problem.terms],
        **({"notes": notes} if notes else {}),
        "cells": problem.num_cells,
        "dofs": problem.dofs,
        "ranks": problem.comm.size,
        **({"time": transient.about} if transient else {}),
        **_describe_obstacles(scene, problem),
        **_describe_bones(scene, problem),
        "load_name": scene.load_name,
        "load_range": list(scene.load_range),
        **({"fields": scene.fields} if scene.fields else {}),
        "linear_solver": solver.linear_solver_name(snes),
        "defaults": describe_defaults(scene, problem, snes),
        "tolerance": solver_options["snes_scaled_tol"] * problem.force_scale,
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


def _describe_obstacles(scene: Scene, problem: Problem) -> dict[str, Any]:
    if not scene.obstacle:
        return {}
    from fem_snh.runs.obstacle_records import describe_obstacles

    return {"obstacles": describe_obstacles(scene, problem)}


def _describe_bones(scene: Scene, problem: Problem) -> dict[str, Any]:
    if not scene.bone:
        return {}
    from fem_snh.runs.bones import describe_bones

    return {"bones": describe_bones(scene, problem)}


def _describe_material(choice: MaterialChoice, region: Region) -> dict[str, Any]:
    """Return a material's entry in run.json, with group and density if the scene has them."""
    energy = region.material.numbers
    mu, lam = energy.lame
    constants = dict(zip(energy.constants, energy.values, strict=True))
    own = {"group": choice.group, "density": choice.density}
    return {
        "name": energy.name,
        "E": energy.E,
        "nu": energy.nu,
        "mu_lame": mu,
        "lambda_lame": lam,
        "parameters": constants | energy.shape,
        **{key: value for key, value in own.items() if value is not None},
    }


class Folder:
    """The output folder, created if it does not exist; only rank 0 writes. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    path : Path
        The folder.
    overwrite, resume : bool
        Accept a folder that holds a run, to replace or to continue it.

    Raises
    ------
    BadInput
        On every rank, if the folder holds a run, does not exist for a resumed run, or is not
        writable.
    """

    def __init__(
        self, comm: MPI.Comm, path: Path, overwrite: bool = False, resume: bool = False
    ) -> None:
        self.comm, self.path = comm, path
        on_root(comm, self._check, overwrite, resume)

    def _check(self, overwrite: bool, resume: bool) -> None:
        """Make the folder and check that a file can be written in it."""
        if (self.path / "run.json").exists() and not (overwrite or resume):
            raise BadInput(
                f"{self.path} already holds a run: give --overwrite or another --out, "
                "or continue it with --resume"
            )
        if resume and not self.path.is_dir():
            raise BadInput(f"there is no folder {self.path} to resume from: start without --resume")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            raise BadInput(
                f"output folder {self.path} cannot be written ({error.strerror}): choose another"
            ) from None

    def clear(self) -> None:
        """Remove the files of an earlier run. Collective."""
        if self.comm.rank == 0:
            for pattern in _OLD_FILES:
                for file in self.path.glob(pattern):
                    remove(file)
            for name in (CHECKPOINT, "steps.csv", "modes.csv"):
                remove(self.path / name)
        self.comm.barrier()

    def write(self, record: dict[str, Any]) -> None:
        """Write run.json and the tables on rank 0. Not collective.

        Raises
        ------
        BadInput
            If a file cannot be written.
        """
        if self.comm.rank:
            return
        steps = [flat(step) for step in record["steps"]]
        columns = dict.fromkeys([*COLUMNS, *(key for step in steps for key in step)])
        replace_file(self.path / "steps.csv", table_text(list(columns), steps))
        if "modes" in record:
            modes = record["modes"]
            numbered = enumerate(zip(modes["frequencies"], modes["residuals"], strict=True), 1)
            rows = [dict(zip(MODE_COLUMNS, (i, *values), strict=True)) for i, values in numbered]
            replace_file(self.path / "modes.csv", table_text(MODE_COLUMNS, rows))
        replace_file(self.path / "run.json", json.dumps(_json_value(record), indent=1) + "\n")


def _json_value(value: Any) -> Any:
    """Return a value for JSON: numpy numbers become Python's; infinity and NaN become null."""
    if isinstance(value, dict):
        return {key: _json_value(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


def _version() -> str:
    """Return the version of the installed package."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("fem_snh")
    except PackageNotFoundError:
        return "unknown"
