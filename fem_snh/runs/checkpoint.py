"""checkpoint.npz: the state from which a run is resumed on any number of ranks.

The file holds displacement and pressure, with the reference coordinates of their nodes, by which a
run on another partition finds its own nodes; the size of the next step; the previous equilibrium,
from which the predictor extrapolates; velocity, acceleration and the previous step of a motion; the
history of terms, such as multipliers of contact; and the diagonal entry of constrained rows. On the
same number of ranks a resumed run is therefore identical bit for bit, unless a preconditioner of
PETSc keeps data from step to step, as GAMG keeps its coarse spaces.

The size is 72 bytes per node, 24 MB for a million unknowns, which rank 0 writes in 0.2 s.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, final

import numpy as np

from fem_snh.arrays import Array
from fem_snh.errors import BadInput, on_root
from fem_snh.files import replace_file
from fem_snh.records.run_files import CHECKPOINT, LEVELS
from fem_snh.records.run_record import Record, load_record
from fem_snh.runs.folder import Folder
from fem_snh.runs.output import nodal_values
from fem_snh.runs.output.nodal_values import gather_rows, match_nodes, scatter_rows
from fem_snh.runs.scene_options import check_same, identity
from fem_snh.scenes import Scene
from fem_snh.steps.stepping import INVERTED, Stepper

if TYPE_CHECKING:
    from fem_snh.problem.goals import Goal
    from fem_snh.runs.setup import Setup


#: Name of the array with the values of `Dirichlet.offset` at the nodes of the displacement.
_OFFSET = "start_offset"
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
        The load steps; and the scene, with which the scene of a resumed run is compared.
    """

    def __init__(self, folder: Folder, setup: Setup) -> None:
        self._folder, self._stepper = folder, setup.stepper
        self._scene = on_root(folder.comm, identity, setup.scene)
        self._fields = nodal_values.fields(setup.problem)
        self._flushed = -_FLUSH_INTERVAL

    def write(self, record: Record) -> None:
        """Write the present state, and ``record``, the content of run.json. Collective.

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
        for name, term in problem.history.by_name.items():
            for key, rows in zip(_history_names(name), term.history(), strict=True):
                arrays[key] = gather_rows(problem.comm, rows)
        if problem.dirichlet.offset is not None:
            offset = problem.x.duplicate()
            offset.array[problem.dirichlet.dofs] = problem.dirichlet.offset
            arrays[_OFFSET] = self._fields["u"].gather(offset)
        motion: Record | None = None
        if moving := self._stepper.motion:
            rows, motion = moving.history()
            arrays["motion"] = gather_rows(problem.comm, rows)
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

    def _write(self, about: Record, arrays: dict[str, Array]) -> None:
        """Replace the file. On rank 0."""
        # Unlike run.json, the text keeps infinities; numpy's numbers become Python's.
        text = json.dumps(about, default=lambda v: v.item()).encode()
        content: Record = {"about": np.frombuffer(text, np.uint8), **arrays}
        flush = monotonic() > self._flushed + _FLUSH_INTERVAL
        path = self._folder.path / CHECKPOINT
        # Where the disk is full, zipfile would report it a second time when Python deletes it.
        archive = BytesIO()
        np.savez(archive, **content)
        replace_file(path, lambda file: file.write(archive.getbuffer()), sync=flush)
        if flush:
            self._flushed = monotonic()


def _history_names(term: str) -> tuple[str, str]:
    """Return the names of two arrays: a term's points, and the values that it keeps there."""
    return f"{term}_points", f"{term}_history"


def load(folder: Path) -> tuple[Record, dict[str, Array]]:
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
        of their nodes; "u_before", the previous equilibrium; "p" (n, 1), "p_nodes" and "p_before"
        of a pressure unknown; "motion" of a dynamic scene; "NAME_points" and "NAME_history" of
        terms.

    Raises
    ------
    BadInput
        If there is no checkpoint, or the file cannot be read.
    """
    path = folder / CHECKPOINT
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {key: stored[key] for key in stored.files}
        about = json.loads(arrays.pop("about").tobytes())
    except FileNotFoundError:
        raise BadInput(
            f"{folder} has no {CHECKPOINT} to resume from: start without --resume"
            + (", with --overwrite" if (folder / "run.json").exists() else "")
        ) from None
    except Exception as error:  # zipfile, zlib, numpy and json raise different ones
        reason = str(error) or type(error).__name__
        raise BadInput(f"{path} cannot be read ({reason}): start again with --overwrite") from None
    return about, arrays


@final
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
    record: Record
    load: float
    finished: bool
    _about: Record
    _arrays: dict[str, Array]

    @classmethod
    def read(cls, folder: Folder, scene: Scene) -> Checkpoint:
        """Return the checkpoint of a run of this scene. Collective.

        Raises
        ------
        BadInput
            On every rank, if there is no checkpoint, or the checkpoint is of another scene.
        """
        arrays: dict[str, Array] = {}

        def read() -> tuple[Record, Record | None]:
            about, found = load(folder.path)
            now = identity(scene)
            if now != about["scene"] and not scene.accuracy and (folder.path / LEVELS).exists():
                raise BadInput(
                    f"cannot resume {folder.path}: it holds levels of a run to an accuracy: "
                    "expected --accuracy (or [accuracy]) as before, with --resume"
                )
            check_same(folder.path, about["scene"], now)
            arrays.update(found)
            return about, _finished(folder.path, about["load"])

        about, completed = on_root(folder.comm, read)
        record = completed or about["record"]
        return cls(folder, record, about["load"], completed is not None, about, arrays)

    def missing(self, scene: Scene, goals: Sequence[Goal]) -> list[str]:
        """Return what the scene asks for of the last state, and `record` lacks: a text each."""
        names = {name for goal in goals for name in goal.asked}
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
    def _last_row(self) -> Record:
        """The row of the last step that converged; empty if no step did."""
        rows = [row for row in self.record["steps"] if row["converged"]]
        return rows[-1] if rows else {}

    def restore(self, stepper: Stepper) -> None:
        """Set the state of the problem and of its load steps. Collective.

        If a finished run lacks the stability that the scene asks for, add it to `record`.

        Raises
        ------
        BadInput
            On every rank, if the nodes are not those of the checkpoint.
        """
        problem, about = stepper.problem, self._about
        fields = nodal_values.fields(problem)
        dirichlet = problem.dirichlet
        before = problem.x.duplicate() if about["load_before"] is not None else None
        for name, field in fields.items():
            order = self._order(field.nodes, f"{name}_nodes")
            field.scatter(self._rows(name, order), problem.x)
            if before is not None:
                field.scatter(self._rows(f"{name}_before", order), before)
            if name == "u" and dirichlet.offset is not None:
                offset = problem.x.duplicate()
                field.scatter(self._rows(_OFFSET, order), offset)
                dirichlet.offset[:] = offset.array_r[dirichlet.dofs]
            if name == "u" and stepper.motion:
                columns = len(about["motion"]["fields"]) * problem.kinematics.components
                shape = len(problem.coordinates), columns
                rows = scatter_rows(problem.comm, self._rows("motion", order), shape)
                stepper.motion.set_history(problem, rows, about["motion"])
        problem.set_load(self.load)
        problem.split(problem.x)
        problem.matrix.set_constrained_diagonal(about["diagonal"])
        stepper.size.next, rows = about["size"], self.record["steps"]
        stepper.taken = sum(row["converged"] for row in rows)
        inverted = [row["load"] for row in rows if row["reason"].startswith(INVERTED)]
        stepper.doubted = inverted[-1] if inverted else stepper.doubted
        for name, term in problem.history.by_name.items():
            points, values = term.history()
            at, kept = _history_names(name)
            order = self._order(gather_rows(problem.comm, points), at)
            term.set_history(scatter_rows(problem.comm, self._rows(kept, order), values.shape))
        if before is not None:
            stepper.solver.predictor.before = (about["load_before"], before)
        if self.finished and "stability" not in self._last_row:
            self._last_row.update(stepper.examine_stability())

    def _order(self, nodes: Array, stored: str) -> Array:
        """Return, on every rank, the indices of rank 0's nodes in a stored array. Collective."""
        return on_root(self.folder.comm, lambda: match_nodes(nodes, self._arrays[stored]))

    def _rows(self, name: str, order: Array) -> Array | None:
        """Return the rows of a stored array in this order, on rank 0; else None."""
        return self._arrays[name][order] if self._arrays else None


def _finished(folder: Path, load: float) -> Record | None:
    """Return the content of run.json if the run reached load 1, else None."""
    path = folder / "run.json"
    if not path.exists():  # the run was killed before it wrote the first one
        return None
    record = load_record(path)
    return record if record.get("converged") and load == 1.0 else None
