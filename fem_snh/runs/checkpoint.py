"""Write checkpoint.npz: the state from which a run is resumed on any number of ranks.

It holds displacement and pressure with the reference coordinates of their nodes, by which another
partition of the mesh finds them; the size of the next step; the previous equilibrium, from which
the predictor extrapolates; in time, velocity, acceleration and the step before; what terms keep, as
multipliers of contact; and the diagonal entry of constrained rows. On the same number of ranks a
resumed run is therefore identical bit for bit, unless a preconditioner of PETSc keeps data from
step to step, as GAMG keeps its coarse spaces.

Its size is 72 bytes per node, 24 MB for a million unknowns, which rank 0 writes in 0.2 s.
"""

from __future__ import annotations

import json
from io import BytesIO
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.kinematics import PLANAR, kinematics_of
from fem_snh.errors import BadInput, on_root, shown
from fem_snh.files import open_file, replace_file
from fem_snh.problem.problem import Problem
from fem_snh.records.run_files import CHECKPOINT
from fem_snh.records.run_record import is_number, problem
from fem_snh.runs.folder import Folder
from fem_snh.runs.output import nodal_values
from fem_snh.runs.output.nodal_values import gather_rows
from fem_snh.runs.scene_options import identity

if TYPE_CHECKING:
    from fem_snh.runs.setup import Setup
    from fem_snh.steps.dynamics.dynamics import Dynamics


Array = npt.NDArray[Any]

#: The array of `StartPath.offset` at the nodes of the displacement.
OFFSET = "start_offset"
#: Seconds between two checkpoints that are flushed to the disk. A flush takes longer than many
#: steps; a loss of power costs at most this time.
_FLUSH_INTERVAL = 1.0


class CheckpointWriter:
    """The writer of a run's checkpoint; its methods are collective.

    Parameters
    ----------
    folder : Folder
        The folder of the output.
    setup : Setup
        The load steps, and the scene, with which that of a resumed run is compared.
    """

    def __init__(self, folder: Folder, setup: Setup) -> None:
        self._folder, self._stepper = folder, setup.stepper
        self._scene = on_root(folder.comm, identity, setup.scene)
        self._fields = nodal_values.fields(setup.problem)
        self._flushed = -_FLUSH_INTERVAL

    def write(self, record: dict[str, Any]) -> None:
        """Write the state and the content of run.json.

        Raises
        ------
        BadInput
            On every rank, if the file cannot be written.
        """
        problem, before = self._stepper.problem, self._stepper.solver.predictor.before
        arrays = {}
        for name, field in self._fields.items():
            arrays[f"{name}_nodes"], arrays[name] = field.nodes, field.gather(problem.x)
            if before:
                arrays[f"{name}_before"] = field.gather(before[1])
        arrays |= gather_terms(problem)
        path = problem.dirichlet.path
        if path is not None:
            offset = problem.x.duplicate()
            offset.array[problem.dirichlet.dofs] = path.offset
            arrays[OFFSET] = self._fields["u"].gather(offset)
        motion: dict[str, Any] | None = None
        if steps := self._stepper.motion:
            arrays["motion"], motion = gather_motion(problem, steps.dynamics)
        about = {
            "scene": self._scene,
            "record": record,
            "load": problem.load,
            "load_before": before[0] if before else None,
            "size": self._stepper.size.next,
            "motion": motion,
            "diagonal": problem.matrix.constrained_diagonal,
        }
        on_root(self._folder.comm, self._write, about, arrays)

    def _write(self, about: dict[str, Any], arrays: dict[str, Array]) -> None:
        """Replace the file on rank 0."""
        # Unlike run.json, the text keeps infinities; numpy's numbers become Python's.
        text = json.dumps(about, default=lambda v: v.item()).encode()
        content: dict[str, Any] = {"about": np.frombuffer(text, np.uint8), **arrays}
        flush = monotonic() > self._flushed + _FLUSH_INTERVAL
        path = self._folder.path / CHECKPOINT
        # Where the disk is full, zipfile would report it a second time when Python deletes it.
        archive = BytesIO()
        np.savez(archive, **content)
        replace_file(path, lambda file: file.write(archive.getbuffer()), sync=flush)
        if flush:
            self._flushed = monotonic()


def history_names(term: str) -> tuple[str, str]:
    """Return the names of the arrays with a term's points and with what it keeps there."""
    return f"{term}_points", f"{term}_history"


def gather_motion(problem: Problem, dynamics: Dynamics) -> tuple[Array, dict[str, Any]]:
    """Return `Dynamics.history` with the rows of all ranks on rank 0. Collective."""
    values, about = dynamics.history()
    return gather_rows(problem.comm, values), about


def gather_terms(problem: Problem) -> dict[str, Array]:
    """Return what the terms keep at their points, on rank 0. Collective."""
    arrays = {}
    for name, term in problem.history.by_name.items():
        points, values = term.history()
        for key, rows in zip(history_names(name), (points, values), strict=True):
            arrays[key] = gather_rows(problem.comm, rows)
    return arrays


def load(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """Read a run's checkpoint. Not collective.

    Parameters
    ----------
    folder : Path
        The folder of the output.

    Returns
    -------
    about : dict
        The scene, the record, the loads and the size of the next step.
    arrays : dict
        "u" (n, components), the displacements [m]; "u_nodes" (n, 3), the reference coordinates [m]
        of their nodes; "u_before", the previous equilibrium; the same for a pressure "p" (n, 1);
        "motion", and "NAME_points" and "NAME_history" of terms.

    Raises
    ------
    BadInput
        If there is no checkpoint, or it cannot be read.
    """
    path = folder / CHECKPOINT
    try:
        with open_file(path) as file, np.load(file, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
        about = json.loads(arrays.pop("about").tobytes())
    except FileNotFoundError:
        raise BadInput(
            f"{folder} has no {CHECKPOINT} to resume from: start without --resume"
            + (", with --overwrite" if (folder / "run.json").exists() else "")
        ) from None
    except Exception as error:  # zipfile, zlib, numpy and json raise different ones
        raise unusable(folder, str(error) or type(error).__name__) from None
    if reason := _mistake(about, arrays):
        raise unusable(folder, reason)
    return about, arrays


def unusable(folder: Path, reason: str) -> BadInput:
    """Return the exception for a checkpoint that cannot be used."""
    return BadInput(
        f"{folder / CHECKPOINT} cannot be read ({reason}): start again with --overwrite"
    )


def _mistake(about: Any, arrays: dict[str, Array]) -> str:
    """Return why the content of a checkpoint cannot be that of a run, or ""."""
    if not isinstance(about, dict):
        return f"about = {shown(about)}: expected a table"
    names = ("scene", "record", "load", "load_before", "size", "motion", "diagonal")
    if missing := [name for name in names if name not in about]:
        return f"{missing[0]}: missing"
    if not isinstance(about["scene"], dict):
        return f"scene = {shown(about['scene'])}: expected a table"
    if reason := problem(about["record"]):
        return f"record: {reason}"
    for key in ("load", "load_before"):
        load = about[key]
        if not (load is None and key == "load_before") and not (is_number(load) and 0 <= load <= 1):
            return f"{key} = {shown(load)}: expected a number from 0 to 1"
    for key in ("size", "diagonal"):
        if about[key] is not None and not (is_number(about[key]) and about[key] > 0):
            return f"{key} = {shown(about[key])}: expected a number > 0"
    kinematics = about["scene"].get("kinematics")
    if kinematics is not None and kinematics not in list(PLANAR):
        return f"kinematics = {shown(kinematics)}: expected one of {', '.join(PLANAR)}"
    components = kinematics_of(kinematics).components
    if reason := _motion_mistake(about["motion"], arrays, components):
        return reason
    for name, columns in (("u", components), ("p", 1)):
        if name == "p" and not {"p", "p_nodes", "p_before"} & arrays.keys():
            continue
        nodes = len(arrays.get(f"{name}_nodes", ()))
        shapes = {f"{name}_nodes": (nodes, 3), name: (nodes, columns)}
        if about["load_before"] is not None:
            shapes[f"{name}_before"] = (nodes, columns)
        for key, shape in shapes.items():
            if reason := _array_mistake(arrays, key, shape):
                return reason
    return ""


def _motion_mistake(motion: Any, arrays: dict[str, Array], components: int) -> str:
    """Return what is wrong with the history of a motion in time, or ""."""
    if motion is None:
        return ""
    fields = motion.get("fields") if isinstance(motion, dict) else None
    if not isinstance(fields, list) or not all(isinstance(name, str) for name in fields):
        return f"motion = {shown(motion)}: expected a table with fields"
    numbers = ["dissipated", "work", *(["step_before"] if "u_before" in fields else [])]
    for key in (*numbers, *(["first_energy"] if "first_energy" in motion else [])):
        if not is_number(motion.get(key)):
            return f"motion.{key} = {shown(motion.get(key))}: expected a number"
    shape = len(arrays.get("u_nodes", ())), components * len(fields)
    return _array_mistake(arrays, "motion", shape)


def _array_mistake(arrays: dict[str, Array], name: str, shape: tuple[int, int]) -> str:
    """Return what is wrong with an array of numbers, or ""."""
    if name not in arrays:
        return f"{name}: missing"
    values = arrays[name]
    if values.shape != shape or values.dtype != np.float64:
        return f"{name}: expected {shape[0]} x {shape[1]} numbers, found shape {values.shape}"
    return "" if np.isfinite(values).all() else f"{name}: expected finite numbers"
