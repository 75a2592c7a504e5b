"""checkpoint.npz: all that a run needs to go on from its last step, on any number of ranks.

Displacement and pressure are kept with the reference coordinates of their nodes, by which another
partition finds them. What else outlives a step is the next step's size, the equilibrium that the
predictor extrapolates from, and the number on the diagonal of prescribed rows; so on the same ranks
a resumed run is the same to the last digit, unless a preconditioner of PETSc's remembers more (as
GAMG does its coarse spaces).

It is 72 bytes a node: 24 MB for a million unknowns, which rank 0 gathers and writes in some 0.2 s;
at 23,000 unknowns it took 1 % of a step's time.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from time import monotonic
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.atomic_files import replace_file
from fem_snh.errors import BadInput, on_root
from fem_snh.runs import nodal_values
from fem_snh.runs.folder import CHECKPOINT, Folder
from fem_snh.runs.stepping import Stepper
from fem_snh.scenes import Scene
from fem_snh.scenes.schema import RENAMED

Array = npt.NDArray[Any]

#: Keys of a scene that say how it is solved, not what: a resumed run may have others.
SOLVER_KEYS = ("hessian", "globalization", "eigensolver", "predictor", "petsc")
#: Seconds of steps that a loss of power may cost: to wait for the disk takes longer than many do.
_UNSAFE = 1.0


class Writer:
    """Writes a run's checkpoint, as often as it is told. Collective."""

    def __init__(self, folder: Folder, scene: Scene, stepper: Stepper) -> None:
        self._folder, self._stepper = folder, stepper
        self._scene = on_root(folder.comm, identity, scene)
        self._fields = nodal_values.fields(stepper.problem)
        self._safe = -_UNSAFE

    def write(self, record: dict[str, Any]) -> None:
        """Keep the present state and ``record``. BadInput on every rank if it cannot."""
        problem, before = self._stepper.problem, self._stepper.predictor.before
        arrays = {}
        for name, field in self._fields.items():
            arrays[f"{name}_nodes"], arrays[name] = field.nodes, field.gather(problem.x)
            if before:
                arrays[f"{name}_before"] = field.gather(before[1])
        about = {
            "scene": self._scene,
            "record": record,
            "load": problem.load,
            "load_before": before[0] if before else None,
            "size": self._stepper.size,
            "diagonal": problem.elastic.constrained_diagonal,
        }
        on_root(self._folder.comm, self._write, about, arrays)

    def _write(self, about: dict[str, Any], arrays: dict[str, Array]) -> None:
        # Infinities stay, which run.json cannot have; numpy's numbers become Python's.
        text = json.dumps(about, default=lambda v: v.item()).encode()
        kept: dict[str, Any] = {"about": np.frombuffer(text, np.uint8), **arrays}
        late = monotonic() > self._safe + _UNSAFE
        path = self._folder.path / CHECKPOINT
        replace_file(path, lambda file: np.savez(file, **kept), sync=late)
        if late:
            self._safe = monotonic()


@dataclass
class Checkpoint:
    """What a folder's checkpoint.npz holds; the arrays are on rank 0 alone.

    Attributes
    ----------
    record : run.json's content, as of the last step.
    load : of that step.
    finished : whether there is nothing left to do.
    """

    folder: Folder
    record: dict[str, Any]
    load: float
    finished: bool
    _about: dict[str, Any]
    _arrays: dict[str, Array]

    @classmethod
    def read(cls, folder: Folder, scene: Scene) -> Checkpoint:
        """Read what a run of this scene has left. Collective.

        BadInput on every rank if there is nothing, or if it is another scene's.
        """
        arrays: dict[str, Array] = {}

        def read() -> tuple[dict[str, Any], dict[str, Any] | None]:
            about, found = load(folder.path)
            # A checkpoint of an older version has keys that are now called otherwise.
            before = {RENAMED.get(key, key): value for key, value in about["scene"].items()}
            _compare(folder.path, before, identity(scene))
            arrays.update(found)
            return about, _finished(folder.path, about["load"])

        about, whole = on_root(folder.comm, read)
        record = whole or about["record"]
        return cls(folder, record, about["load"], whole is not None, about, arrays)

    def restore(self, stepper: Stepper) -> None:
        """Put the state into the problem and the stepper. Collective.

        BadInput on every rank if the mesh is another one.
        """
        problem, about = stepper.problem, self._about
        before = problem.x.duplicate() if about["load_before"] is not None else None
        for name, field in nodal_values.fields(problem).items():
            order = self._order(field, name)
            self._put(field, name, order, problem.x)
            if before is not None:
                self._put(field, f"{name}_before", order, before)
        problem.set_load(self.load)
        problem.update_functions()
        problem.elastic.set_constrained_diagonal(about["diagonal"])
        stepper.size = about["size"]
        if before is not None:
            stepper.predictor.before = (about["load_before"], before)

    def _order(self, field: nodal_values.NodalField, name: str) -> Array:
        """For each node the number of its values, on rank 0."""
        order: list[Array] = []
        on_root(
            self.folder.comm,
            lambda: order.append(
                nodal_values.match_nodes(field.nodes, self._arrays[f"{name}_nodes"])
            ),
        )
        return order[0] if order else np.empty(0, int)

    def _put(self, field: nodal_values.NodalField, name: str, order: Array, x: PETSc.Vec) -> None:
        field.scatter(self._arrays[name][order] if self._arrays else None, x)


def load(folder: Path) -> tuple[dict[str, Any], dict[str, Array]]:
    """The description and the arrays of a run's checkpoint: "u" (n, 3), "u_nodes" (n, 3), ...

    Not collective. BadInput if there is none that can be read.
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
    except Exception as error:  # zipfile, zlib, numpy and json each have their own
        raise BadInput(f"{path} cannot be read ({error}): start again with --overwrite") from None
    return about, arrays


def _finished(folder: Path, load: float) -> dict[str, Any] | None:
    """run.json of a run that came to its end."""
    try:
        record: dict[str, Any] = json.loads((folder / "run.json").read_text())
    except (OSError, ValueError):
        return None
    return record if record.get("converged") and load == 1.0 else None


def identity(scene: Scene) -> dict[str, Any]:
    """Return the values that a resumed run must have in common, by dotted keys.

    Of a mesh file and of a material's Python file the content counts, wherever the file is.
    """
    data = scene.model_dump(mode="json", exclude=set(SOLVER_KEYS))
    if isinstance(scene.mesh, Path):
        data["mesh"] = _digest("mesh", scene.mesh)
    for path in scene.material.files:
        data["material"][path.name] = _digest("material", path)
    return _flat(data)


def _digest(key: str, path: Path) -> str:
    """Return a short hash of a file's content. Raises BadInput if it cannot be read."""
    try:
        with path.open("rb") as file:
            return "sha256 " + hashlib.file_digest(file, "sha256").hexdigest()[:16]
    except OSError as error:
        raise BadInput(f"{key}: cannot read {path}: {error.strerror}") from None


def _flat(value: Any, key: str = "") -> dict[str, Any]:
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return {k: v for name, part in items for k, v in _flat(part, f"{key}.{name}").items()}
    return {key.removeprefix("."): value}


def _compare(folder: Path, before: dict[str, Any], now: dict[str, Any]) -> None:
    for key in dict.fromkeys([*before, *now]):
        if before.get(key) != now.get(key):
            raise BadInput(
                f"cannot resume {folder}: {key} = {_said(now, key)}, but it was run with "
                f"{_said(before, key)}; only {', '.join(SOLVER_KEYS)} and the ranks may be others"
            )


def _said(scene: dict[str, Any], key: str) -> str:
    return json.dumps(scene[key]) if key in scene else "nothing"
