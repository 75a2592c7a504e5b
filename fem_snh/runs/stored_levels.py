"""Write and read levels.npz, from which a run to an accuracy continues with the next level.

The file has the rows of the levels; and of the last level its changes of the first level's scene,
its mesh if that is not the scene's, and the errors in its cells. checkpoint.npz has the solution.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from io import BytesIO
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx, scenes
from fem_snh.accuracy.goal_errors import Estimate, GoalError, Place
from fem_snh.accuracy.levels import LevelRow, Levels
from fem_snh.accuracy.refinement import Lineage
from fem_snh.errors import BadInput, on_root
from fem_snh.files import replace_file
from fem_snh.mesh.gmsh_model import MeshData, PhysicalGroup
from fem_snh.mesh.mesh import Mesh, distribute, gather
from fem_snh.mesh.round_faces import RoundFaces
from fem_snh.records.run_files import LEVELS
from fem_snh.records.run_record import load_record
from fem_snh.runs.folder import Folder
from fem_snh.runs.scene_options import check_same, identity

Array = npt.NDArray[Any]
#: Keys of the mesh's arrays; and beginnings of keys of errors in cells and of groups' entities,
#: which a number follows.
_CELLS, _NODES, _ERROR, _GROUP = "cells", "x", "error_", "group_"
_LINEAGE = "parents", "errors_before", "rates_before"


@dataclass(frozen=True)
class StoredLevels:
    """The content of levels.npz.

    Attributes
    ----------
    changes : mapping
        The ``changes`` that `write_levels` was given.
    mesh : Mesh or None
        The mesh of the last level, if it is not the scene's.
    lineage : Lineage or None
        Where its cells come from, on rank 0.
    rows : list of LevelRow
        The rows of the levels; the last one has no errors in cells before `restore_errors`.
    """

    changes: Mapping[str, Any]
    mesh: Mesh | None
    lineage: Lineage | None
    rows: list[LevelRow]
    _errors: Mapping[str, Array]

    def restore_errors(self, row: LevelRow, domain: _dolfinx.Mesh) -> None:
        """Set the errors in this rank's cells of the last level's row."""
        rows = _dolfinx.input_cells(domain)[: _dolfinx.num_owned(domain)]
        row.estimate.indicators = {name: values[rows] for name, values in self._errors.items()}


def write_levels(
    folder: Folder,
    scene: scenes.Scene,
    levels: Levels,
    changes: Mapping[str, Any],
    domain: _dolfinx.Mesh,
    mesh: Mesh | None,
    lineage: Lineage | None,
) -> None:
    """Write the levels so far. Collective.

    Parameters
    ----------
    folder : Folder
        The folder of the last level, which is complete.
    scene : Scene
        The scene as it was given.
    levels : Levels
        The levels.
    changes : mapping
        The last level's changes of the first level's scene, values for JSON.
    domain : dolfinx Mesh
        The mesh of the last level.
    mesh : Mesh or None
        The same mesh with its groups, if it is not the scene's.
    lineage : Lineage or None
        Where its cells come from, on rank 0.
    """
    last = levels.rows[-1].estimate.indicators
    arrays = {f"{_ERROR}{i}": _of_cells(domain, last[name]) for i, name in enumerate(last)}
    about = {
        "scene": _identity(scene),
        "rows": [_row_record(row) for row in levels.rows],
        "changes": dict(changes),
        "errors": list(last),
        "mesh": None,
    }
    if lineage:
        arrays |= dict(zip(_LINEAGE, lineage, strict=True))
    if mesh:
        data = gather(mesh)
        arrays |= {_CELLS: data.cells, _NODES: data.x}
        arrays |= {f"{_GROUP}{i}": group.entities for i, group in enumerate(data.groups)}
        about["mesh"] = {
            "cell": data.cell,
            "degree": data.degree,
            "groups": [(group.name, group.dim, group.tag) for group in data.groups],
            "round_faces": mesh.round_faces,
        }

    def write() -> None:
        text = json.dumps(about, default=lambda number: number.item()).encode()
        archive = BytesIO()
        np.savez(archive, about=np.frombuffer(text, np.uint8), **arrays)
        replace_file(folder.path / LEVELS, lambda file: file.write(archive.getbuffer()), sync=True)

    on_root(folder.comm, write)


def read_levels(folder: Folder, scene: scenes.Scene) -> StoredLevels | None:
    """Return the levels of a folder; None if no level was finished. Collective.

    Raises
    ------
    BadInput
        On every rank, for a folder with another run, or a file that cannot be read.
    """
    path, arrays = folder.path / LEVELS, dict[str, Array]()

    def read() -> dict[str, Any] | None:
        if not path.exists():
            record = folder.path / "run.json"
            if record.exists() and "accuracy" not in load_record(record):
                raise BadInput(
                    f"cannot resume {folder.path}: accuracy.within = {scene.within}: expected no "
                    "value, as before, or another folder"
                )
            return None
        try:
            with np.load(path, allow_pickle=False) as stored:
                arrays.update({key: stored[key] for key in stored.files})
            about: dict[str, Any] = json.loads(arrays.pop("about").tobytes())
            before = about["scene"]
            about["rows"] = [_row(row) for row in about["rows"]]
            about["errors"] = {n: arrays.pop(f"{_ERROR}{i}") for i, n in enumerate(about["errors"])}
        except Exception as error:  # zipfile, zlib, numpy and json raise different ones
            reason = str(error) or type(error).__name__
            raise BadInput(
                f"{path} cannot be read ({reason}): start again with --overwrite"
            ) from None
        check_same(folder.path, before, _identity(scene))
        return about

    about = on_root(folder.comm, read)
    if about is None:
        return None
    mesh = _mesh(folder, about["mesh"], arrays) if about["mesh"] else None
    known = [arrays[key] for key in _LINEAGE if key in arrays]
    lineage = Lineage(*known) if known else None
    return StoredLevels(about["changes"], mesh, lineage, about["rows"], about["errors"])


def _mesh(folder: Folder, about: Mapping[str, Any], arrays: Mapping[str, Array]) -> Mesh:
    """Return the stored mesh, distributed from rank 0. Collective."""

    def make() -> MeshData:
        groups = [
            PhysicalGroup(name, dim, tag, arrays[f"{_GROUP}{i}"])
            for i, (name, dim, tag) in enumerate(about["groups"])
        ]
        return MeshData(arrays[_CELLS], arrays[_NODES], about["cell"], about["degree"], groups)

    made = distribute(folder.comm, str(folder.path / LEVELS), make)
    faces = about["round_faces"]
    return replace(made, round_faces=RoundFaces(*faces) if faces else None)


def _identity(scene: scenes.Scene) -> dict[str, Any]:
    """Return the values that must not change between the levels, by dotted keys."""
    wanted = scene.accuracy
    assert wanted
    goals = [g.name if g.at is None else f"{g.name} at {g.at}" for g in wanted.goals]
    keys = {"keep_element": wanted.keep_element, "goals": goals}
    return identity(scene) | {f"accuracy.{key}": value for key, value in keys.items()}


def _of_cells(domain: _dolfinx.Mesh, values: Array) -> Array:
    """Return values of owned cells on rank 0 in the order of the mesh's input. Collective."""
    rows = _dolfinx.input_cells(domain)[: len(values)]
    parts = domain.comm.gather((rows, values)) or [(rows, values)]
    numbers, gathered = map(np.concatenate, zip(*parts, strict=True))
    return np.asarray(gathered[np.argsort(numbers)])


def _row_record(row: LevelRow) -> dict[str, Any]:
    """Return a level's row as values for JSON, without the errors in its cells."""
    return asdict(replace(row, estimate=replace(row.estimate, indicators={})))


def _row(record: dict[str, Any]) -> LevelRow:
    """Return a level's row from the values of `_row_record`."""
    found = record["estimate"]
    places = {n: Place(**p | {"largest": tuple(p["largest"])}) for n, p in found["places"].items()}
    errors = {name: GoalError(**goal) for name, goal in found["goals"].items()}
    estimate = Estimate(**found | {"goals": errors, "places": places})
    goals = {name: GoalError(**goal) for name, goal in record["goals"].items()}
    return LevelRow(**record | {"estimate": estimate, "goals": goals})
