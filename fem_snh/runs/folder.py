"""The output folder of a run: run.json and the tables, each replaced as a whole.

`fem_snh.runs.recorder` decides when these files are written.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx, solver
from fem_snh.assembly.regions import Region
from fem_snh.errors import BadInput, on_root
from fem_snh.files import output_path, remove, replace_file
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import is_free
from fem_snh.records.run_files import (
    LEVELS,
    NEXT_LEVEL,
    FolderLock,
    lock_run,
    remove_run,
    run_files,
    take_run,
)
from fem_snh.records.run_record import Note, Record, flat, table_text
from fem_snh.runs.notes import kinks, mesh_note, partial_rotation_notes, shape_notes, turns
from fem_snh.runs.scene_options import describe_condensation, describe_defaults
from fem_snh.scenes import MaterialChoice, Scene
from fem_snh.terms.feature import grouped

if TYPE_CHECKING:
    from fem_snh.runs.setup import Setup
    from fem_snh.steps.dynamics.dynamics import Dynamics

#: Columns of steps.csv that every run has.
COLUMNS = (
    "load", "converged", "reason", "newton", "clamped", "linear", "lbfgs", "residual",
    "tolerance", "energy", "volume_ratio", "min_J", "min_cell_J", "max_u", "nonfinite",
    "seconds",
)  # fmt: skip
#: Columns of modes.csv.
MODE_COLUMNS = ("mode", "frequency", "residual")


def describe(setup: Setup) -> Record:
    """Return the content of run.json before the first step. Collective.

    The record describes the scene, its material, discretisation and solver; its steps are empty.
    """
    scene, problem, snes = setup.scene, setup.problem, setup.snes
    motion = setup.stepper.motion
    solver_options = snes.getPythonContext().options
    materials = [
        _describe_material(choice, region)
        for choice, region in zip(scene.materials, problem.regions, strict=True)
    ]
    texts = [text for term in problem.terms if (text := term.note)]
    texts += [*turns(scene), *partial_rotation_notes(scene), *kinks(scene)]
    texts += [*problem.dirichlet.contradictions(), *problem.reaction_notes]
    texts += [
        f"reactions of {key!r}: nothing constrains its nodes: the force is zero, up to the residual"
        for key in (reaction.group for reaction in scene.reactions)
        if is_free(problem, setup.mesh, key)
    ]
    loads = [Note("load", text) for text in texts]
    shapes = [Note("mesh", text) for text in shape_notes(scene)]
    notes = [note.record() for note in (*loads, *shapes, mesh_note(scene, problem)) if note]
    about = {
        "scene": scene.name,
        "material": materials[0] if len(materials) == 1 else materials,
        "element": scene.element,
        **({"kinematics": scene.kinematics} if scene.kinematics else {}),
        "quadrature": problem.element.quadrature,
        "hessian": solver_options["snes_hessian"],
        "globalization": solver_options["snes_globalization"],
        "terms": [term.name for term in problem.terms],
        **({"notes": notes} if notes else {}),
        "cells": problem.num_cells,
        "dofs": problem.dofs,
        "ranks": problem.comm.size,
        **({"time": _describe_time(scene, problem, motion)} if motion else {}),
        **_describe_features(scene, problem),
        **_describe_bones(scene, problem),
        **({"units": scene.units} if scene.units else {}),
        "load_name": scene.load_name,
        "load_range": list(scene.load_range),
        **({"fields": scene.fields, "fields_at": scene.fields_at} if scene.fields else {}),
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
    describe_condensation(about, problem.element, setup.condensation)
    return about


def _describe_time(scene: Scene, problem: Problem, motion: Dynamics) -> Record:
    """Return the entry ``time`` of run.json. Collective.

    ``start`` has the energies, momenta and reactions at the start.
    """
    table = {} if scene.time is None else scene.time.model_dump()
    given = {key: value for key, value in table.items() if value is not None}
    start = motion.energies(problem)
    return given | {"start": start | problem.reaction_sums(problem.x)}


def _describe_features(scene: Scene, problem: Problem) -> Record:
    """Return the entries of the scene's features in run.json. Collective."""
    found: Record = {}
    for kind, features in grouped(scene.features):
        terms = [term for term in problem.terms if term.name == kind.key]
        found |= kind.describe(features, terms)
    return found


def _describe_bones(scene: Scene, problem: Problem) -> Record:
    if not scene.bone:
        return {}
    from fem_snh.runs.bone_records import describe_bones

    return {"bones": describe_bones(scene, problem)}


def _describe_material(choice: MaterialChoice, region: Region) -> Record:
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
        **({"equation": energy.equation} if energy.equation else {}),
        **{key: value for key, value in own.items() if value is not None},
    }


class Folder:
    """The locked output folder, created if it does not exist; only rank 0 writes. Collective.

    `close` releases the lock.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    path : str or Path
        The folder.
    inputs : iterable of Path
        The files that the run reads.
    overwrite, resume : bool
        Accept a folder that is not empty, to replace or to continue the run in it.

    Attributes
    ----------
    note : str
        Why the folder is not locked; "" if it is.

    Raises
    ------
    BadInput
        On every rank, if the folder is not empty and neither flag is set, does not exist for a
        resumed run, is not writable, is used by another process, or holds an input that the run
        might replace.
    """

    def __init__(
        self,
        comm: MPI.Comm,
        path: str | Path,
        inputs: Iterable[Path] = (),
        overwrite: bool = False,
        resume: bool = False,
    ) -> None:
        self.comm, self.path = comm, output_path("out", path)
        #: The folder that has the files in the end; see `next_level`.
        self.final = self.path
        self._lock: FolderLock | None = None
        self.note = on_root(comm, self._open, inputs, overwrite, resume)
        if resume and on_root(comm, (self.path / NEXT_LEVEL / LEVELS).exists):
            self.take(self.next_level(resume=True))  # a process was killed in `take`

    def _open(self, inputs: Iterable[Path], overwrite: bool, resume: bool) -> str:
        """Create and lock the folder; return `note`. On rank 0."""
        if resume and not self.path.is_dir():
            raise BadInput(f"there is no folder {self.path} to resume from: start without --resume")
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(
                f"output folder {self.path} cannot be written ({error.strerror}): choose another"
            ) from None
        self._lock = lock_run(self.path, inputs, overwrite, resume)
        return self._lock.note

    def close(self) -> None:
        """Release the lock. Not collective."""
        if self._lock:
            self._lock.close()

    def clear(self) -> None:
        """Remove the files of an earlier run. Collective."""

        def clear() -> None:
            for name in run_files(self.path):
                remove(self.path / name)
            if (level := self.path / NEXT_LEVEL).is_dir():
                remove_run(level)

        on_root(self.comm, clear)

    def next_level(self, resume: bool = False) -> Folder:
        """Return a subfolder for the next level of a run to an accuracy: see `take`. Collective.

        It is a new one, or with ``resume`` the one that a process has left.
        """
        folder = Folder(self.comm, self.path / NEXT_LEVEL, (), not resume, resume)
        folder.final = self.path
        return folder

    def take(self, level: Folder) -> None:
        """Replace the run by the complete run in a folder from `next_level`. Collective."""
        level.close()
        on_root(self.comm, take_run, self.path, level.path)

    def write(self, record: Record) -> None:
        """Write run.json and the tables on rank 0. Not collective.

        Raises
        ------
        BadInput
            If a file cannot be written.
        """
        if self._lock is None:
            return
        steps = [flat(step) for step in record["steps"]]
        columns = dict.fromkeys([*COLUMNS, *(key for step in steps for key in step)])
        replace_file(self.path / "steps.csv", table_text(list(columns), steps))
        if "modes" in record:
            modes = record["modes"]
            numbered = enumerate(zip(modes["frequencies"], modes["residuals"], strict=True), 1)
            rows = [dict(zip(MODE_COLUMNS, (i, *values), strict=True)) for i, values in numbered]
            replace_file(self.path / "modes.csv", table_text(MODE_COLUMNS, rows))
        whole = record | {"files": sorted({*run_files(self.path), "run.json"})}
        replace_file(self.path / "run.json", _json_text(whole) + "\n")


def _json_text(record: Record) -> str:
    """Return the text of run.json, with each step in one line.

    All steps are written after each. Python's encoder in C, 20 times faster, does not indent.
    """
    empty = "[]"
    text = json.dumps(_json_value(record | {"steps": []}), indent=1)
    before, key, after = text.partition(f'\n "steps": {empty}')
    rows = ",".join(f"\n  {_row_text(row)}" for row in record["steps"])
    return f"{before}{key.removesuffix(empty)}[{rows}\n ]{after}" if rows else text


def _row_text(row: Record) -> str:
    """Return the JSON of a step. Infinity and NaN, which are rare, become null."""
    try:
        return json.dumps(row, default=lambda number: number.item(), allow_nan=False)
    except ValueError:
        return json.dumps(_json_value(row))


def _json_value(value: Any) -> Any:
    """Return a value for JSON: numpy numbers become Python's; infinity and NaN become null."""
    if isinstance(value, dict):
        return {key: _json_value(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_json_value(v) for v in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not np.isfinite(value) else value


@cache
def _version() -> str:
    """Return the version of the installed package."""
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("fem_snh")
    except PackageNotFoundError:
        return "unknown"
