"""Write and read checkpoint.npz: the state from which a run is resumed on any number of ranks.

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
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.kinematics import PLANAR, kinematics_of
from fem_snh.atomic_files import replace_file
from fem_snh.errors import BadInput, on_root, shown
from fem_snh.files import open_file
from fem_snh.problem.problem import Problem
from fem_snh.run_files import CHECKPOINT
from fem_snh.run_record import is_number, load_record, problem
from fem_snh.runs.folder import Folder
from fem_snh.runs.output import nodal_values
from fem_snh.runs.output.nodal_values import gather_rows, match_nodes, scatter_rows
from fem_snh.runs.scene_identity import check_same, identity
from fem_snh.scenes import Scene
from fem_snh.steps.stepping import Stepper

if TYPE_CHECKING:
    from fem_snh.accuracy.goals import Goal
    from fem_snh.steps.dynamics.dynamics import Dynamics

Array = npt.NDArray[Any]

#: The array of `StartPath.offset` at the nodes of the displacement.
_OFFSET = "start_offset"
#: Seconds between two checkpoints that are flushed to the disk. A flush takes longer than many
#: steps; a loss of power costs at most this time.
_FLUSH_INTERVAL = 1.0


class Writer:
    """The writer of a run's checkpoint; its methods are collective.

    Parameters
    ----------
    folder : Folder
        The folder of the output.
    scene : Scene
        The scene, with which a resumed run is compared.
    stepper : Stepper
        The load steps.
    """

    def __init__(self, folder: Folder, scene: Scene, stepper: Stepper) -> None:
        self._folder, self._stepper = folder, stepper
        self._scene = on_root(folder.comm, identity, scene)
        self._fields = nodal_values.fields(stepper.problem)
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
        path = getattr(problem.dirichlet, "path", None)
        if path is not None:
            offset = problem.x.duplicate()
            offset.array[problem.dirichlet.dofs] = path.offset
            arrays[_OFFSET] = self._fields["u"].gather(offset)
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
        self._folder.announce(CHECKPOINT)
        # Where the disk is full, zipfile would report it a second time when Python deletes it.
        archive = BytesIO()
        np.savez(archive, **content)
        replace_file(path, lambda file: file.write(archive.getbuffer()), sync=flush)
        if flush:
            self._flushed = monotonic()


@dataclass
class Checkpoint:
    """The content of a folder's checkpoint.npz; only rank 0 has the arrays.

    Attributes
    ----------
    folder : Folder
        The folder of the output.
    record : dict
        The content of run.json after the last step.
    load : float
        The load of that step.
    finished : bool
        Whether the run reached load 1.
    """

    folder: Folder
    record: dict[str, Any]
    load: float
    finished: bool
    _about: dict[str, Any]
    _arrays: dict[str, Array]

    @classmethod
    def read(cls, folder: Folder, scene: Scene) -> Checkpoint:
        """Return the checkpoint of a run of this scene. Collective.

        Raises
        ------
        BadInput
            On every rank, if there is no checkpoint or it is that of another scene.
        """
        arrays: dict[str, Array] = {}

        def read() -> tuple[dict[str, Any], dict[str, Any] | None]:
            about, found = load(folder.path)
            check_same(folder.path, about["scene"], identity(scene))
            arrays.update(found)
            return about, _finished(folder.path, about["load"])

        about, completed = on_root(folder.comm, read)
        record = completed or about["record"]
        return cls(folder, record, about["load"], completed is not None, about, arrays)

    def missing(self, scene: Scene, goals: Sequence[Goal]) -> list[str]:
        """Return what the scene asks for of its last state, and the run does not have."""
        names = {name for goal in goals for name in goal.names}
        known = set(self.record.get("fields", ()))
        fields = [field for field in scene.fields if field not in known]
        if scene.fields and scene.fields_at != self.record.get("fields_at"):
            fields = list(scene.fields)
        missing = {
            "errors of goals": names and names != set(self.record.get("goals", ())),
            "stability": scene.stability and "stability" not in self._last_row,
            f"fields {', '.join(fields)}": fields,
        }
        return [text for text, is_missing in missing.items() if is_missing]

    @property
    def _last_row(self) -> dict[str, Any]:
        """The row of the last step that converged; empty without any."""
        rows = [row for row in self.record["steps"] if row["converged"]]
        return rows[-1] if rows else {}

    def restore(self, stepper: Stepper) -> None:
        """Set the state of the problem and of its load steps. Collective.

        Raises
        ------
        BadInput
            On every rank, if the mesh is not that of the checkpoint.
        """
        problem, about = stepper.problem, self._about
        fields = nodal_values.fields(problem)
        path = getattr(problem.dirichlet, "path", None)
        needed = [_OFFSET] if path is not None else []
        on_root(
            self.folder.comm, self._check_parts, list(fields), needed, stepper.motion is not None
        )
        before = problem.x.duplicate() if about["load_before"] is not None else None
        for name, field in fields.items():
            order = self._order(field, name)
            self._scatter(field, name, order, problem.x)
            if before is not None:
                self._scatter(field, f"{name}_before", order, before)
            if name == "u" and path is not None:
                offset = problem.x.duplicate()
                self._scatter(field, _OFFSET, order, offset)
                path.offset = offset.array_r[problem.dirichlet.dofs]
            if name == "u" and (steps := stepper.motion):
                rows = self._rows("motion", order)
                restore_motion(problem, steps.dynamics, rows, about["motion"])
        problem.set_load(self.load)
        problem.split(problem.x)
        problem.matrix.set_constrained_diagonal(about["diagonal"])
        stepper.size.next = about["size"]
        stepper.taken = sum(row["converged"] for row in self.record["steps"])
        restore_terms(problem, self._arrays)
        if before is not None:
            stepper.solver.predictor.before = (about["load_before"], before)
        if self.finished and "stability" not in self._last_row:
            self._last_row.update(stepper.examine_stability())

    def _check_parts(self, fields: list[str], arrays: list[str], moves: bool) -> None:
        """Raise BadInput unless the checkpoint has what this problem needs. On rank 0."""
        needed = [*(f"{name}_nodes" for name in fields), *arrays, *(["motion"] if moves else [])]
        if moves and self._about["motion"] is None:
            raise _unusable(self.folder.path, "motion: missing")
        if missing := [name for name in needed if name not in self._arrays]:
            raise _unusable(self.folder.path, f"{missing[0]}: missing")

    def _order(self, field: nodal_values.NodalField, name: str) -> Array:
        """Return, on rank 0, the index of the stored values of each node."""
        order: list[Array] = []
        on_root(
            self.folder.comm,
            lambda: order.append(
                nodal_values.match_nodes(field.nodes, self._arrays[f"{name}_nodes"])
            ),
        )
        return order[0] if order else np.empty(0, int)

    def _scatter(
        self, field: nodal_values.NodalField, name: str, order: Array, x: PETSc.Vec
    ) -> None:
        """Set a field's entries of ``x`` to the array ``name``. Collective."""
        field.scatter(self._rows(name, order), x)

    def _rows(self, name: str, order: Array) -> Array | None:
        """Return, on rank 0, an array in this order."""
        return self._arrays[name][order] if self._arrays else None


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
        "u" (n, 3), the displacements; "u_nodes" (n, 3), their reference coordinates;
        "u_before" (n, 3), the previous equilibrium; and the same for the pressure "p" (n, 1).

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
        raise _unusable(folder, str(error) or type(error).__name__) from None
    if reason := _problem(about, arrays):
        raise _unusable(folder, reason)
    return about, arrays


def _unusable(folder: Path, reason: str) -> BadInput:
    return BadInput(
        f"{folder / CHECKPOINT} cannot be read ({reason}): start again with --overwrite"
    )


def _problem(about: Any, arrays: dict[str, Array]) -> str:
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
    if reason := _motion_problem(about["motion"], arrays, components):
        return reason
    for name, columns in (("u", components), ("p", 1)):
        if name == "p" and not {"p", "p_nodes", "p_before"} & arrays.keys():
            continue
        nodes = len(arrays.get(f"{name}_nodes", ()))
        shapes = {f"{name}_nodes": (nodes, 3), name: (nodes, columns)}
        if about["load_before"] is not None:
            shapes[f"{name}_before"] = (nodes, columns)
        for key, shape in shapes.items():
            if reason := _array_problem(arrays, key, shape):
                return reason
    return ""


def _motion_problem(motion: Any, arrays: dict[str, Array], components: int) -> str:
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
    return _array_problem(arrays, "motion", shape)


def _array_problem(arrays: dict[str, Array], name: str, shape: tuple[int, int]) -> str:
    """Return what is wrong with an array of numbers, or ""."""
    if name not in arrays:
        return f"{name}: missing"
    values = arrays[name]
    if values.shape != shape or values.dtype != np.float64:
        return f"{name}: expected {shape[0]} x {shape[1]} numbers, found shape {values.shape}"
    return "" if np.isfinite(values).all() else f"{name}: expected finite numbers"


def _finished(folder: Path, load: float) -> dict[str, Any] | None:
    """Return the content of run.json if the run reached load 1, else None."""
    path = folder / "run.json"
    if not path.exists():  # the run was killed before it wrote the first one
        return None
    record = load_record(path)
    return record if record.get("converged") and load == 1.0 else None


#: Names of the arrays of a term's history.
_POINTS, _VALUES = "{}_points", "{}_history"


def gather_motion(problem: Problem, dynamics: Dynamics) -> tuple[Array, dict[str, Any]]:
    """Return `Dynamics.history` with the rows of all ranks on rank 0. Collective."""
    values, about = dynamics.history()
    return gather_rows(problem.comm, values), about


def restore_motion(
    problem: Problem, dynamics: Dynamics, values: Array | None, about: dict[str, Any]
) -> None:
    """Continue the motion from the ``values`` on rank 0, in the order of the nodes. Collective."""
    comm = problem.comm
    columns = comm.bcast(None if values is None else values.shape[1])
    own = scatter_rows(comm, values, (len(problem.coordinates), columns))
    dynamics.set_history(problem, own, about)


def gather_terms(problem: Problem) -> dict[str, Array]:
    """Return what the terms keep at their points, on rank 0. Collective."""
    arrays = {}
    for name, term in problem.history.by_name.items():
        points, values = term.history()
        arrays[_POINTS.format(name)] = gather_rows(problem.comm, points)
        arrays[_VALUES.format(name)] = gather_rows(problem.comm, values)
    return arrays


def restore_terms(problem: Problem, arrays: dict[str, Array]) -> None:
    """Set what the terms keep at their points. Collective.

    Raises
    ------
    BadInput
        On every rank, if the points are not those of the checkpoint.
    """
    for name, term in problem.history.by_name.items():
        points, values = term.history()
        wanted = gather_rows(problem.comm, points)
        order = on_root(problem.comm, _rows_of, name, wanted, values.shape[1], arrays)
        kept = None if problem.comm.rank else arrays[_VALUES.format(name)][order]
        term.set_history(scatter_rows(problem.comm, kept, values.shape))


def _rows_of(name: str, wanted: Array, columns: int, arrays: dict[str, Array]) -> Array:
    """Return the rows of a term's arrays that belong to points; BadInput if they do not fit."""
    points, values = (arrays.get(key.format(name)) for key in (_POINTS, _VALUES))
    if points is None or values is None or points.ndim != 2 or points.shape[1] != 3:
        raise BadInput(f"the checkpoint has no history of {name}: start again with --overwrite")
    if values.shape != (len(points), columns):
        raise BadInput(
            f"the checkpoint has a history of {name} of shape {values.shape}, expected "
            f"{(len(points), columns)}: start again with --overwrite"
        )
    return match_nodes(wanted, points)
