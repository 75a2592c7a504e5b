"""Resume a run: the state of its checkpoint, on any number of ranks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.choices import COARSER_MESHES
from fem_snh.errors import BadInput, on_root
from fem_snh.problem.problem import Problem
from fem_snh.records.run_files import LEVELS
from fem_snh.records.run_record import load_record
from fem_snh.runs.checkpoint import OFFSET, history_names, load, unusable
from fem_snh.runs.folder import Folder
from fem_snh.runs.output import nodal_values
from fem_snh.runs.output.nodal_values import gather_rows, match_nodes, scatter_rows
from fem_snh.runs.scene_options import check_same, identity
from fem_snh.scenes import Scene
from fem_snh.steps.stepping import Stepper

if TYPE_CHECKING:
    from fem_snh.accuracy.goals import Goal
    from fem_snh.steps.dynamics.dynamics import Dynamics

Array = npt.NDArray[Any]


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
        """Return what the scene asks for of its last state, and the run does not have."""
        names = {name for goal in goals for name in goal.names}
        known = set(self.record.get("fields", ()))
        fields = [field for field in scene.fields if field not in known]
        if scene.fields and scene.fields_at != self.record.get("fields_at"):
            fields = list(scene.fields)
        by_meshes = bool(scene.accuracy and scene.accuracy.estimate == COARSER_MESHES)
        is_other = by_meshes != ("coarser" in self.record.get("estimate", ()))
        missing = {
            "errors of goals": names and (is_other or names != set(self.record.get("goals", ()))),
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
        path = problem.dirichlet.path
        needed = [OFFSET] if path is not None else []
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
                self._scatter(field, OFFSET, order, offset)
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
            raise unusable(self.folder.path, "motion: missing")
        if missing := [name for name in needed if name not in self._arrays]:
            raise unusable(self.folder.path, f"{missing[0]}: missing")

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


def _finished(folder: Path, load: float) -> dict[str, Any] | None:
    """Return the content of run.json if the run reached load 1, else None."""
    path = folder / "run.json"
    if not path.exists():  # the run was killed before it wrote the first one
        return None
    record = load_record(path)
    return record if record.get("converged") and load == 1.0 else None


def restore_motion(
    problem: Problem, dynamics: Dynamics, values: Array | None, about: dict[str, Any]
) -> None:
    """Continue the motion from the ``values`` on rank 0, in the order of the nodes. Collective."""
    comm = problem.comm
    columns = comm.bcast(None if values is None else values.shape[1])
    own = scatter_rows(comm, values, (len(problem.coordinates), columns))
    dynamics.set_history(problem, own, about)


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
        kept = None if problem.comm.rank else arrays[history_names(name)[1]][order]
        term.set_history(scatter_rows(problem.comm, kept, values.shape))


def _rows_of(name: str, wanted: Array, columns: int, arrays: dict[str, Array]) -> Array:
    """Return the rows of a term's arrays that belong to points; BadInput if they do not fit."""
    points, values = map(arrays.get, history_names(name))
    if points is None or values is None or points.ndim != 2 or points.shape[1] != 3:
        raise BadInput(f"the checkpoint has no history of {name}: start again with --overwrite")
    if values.shape != (len(points), columns):
        raise BadInput(
            f"the checkpoint has a history of {name} of shape {values.shape}, expected "
            f"{(len(points), columns)}: start again with --overwrite"
        )
    return match_nodes(wanted, points)
