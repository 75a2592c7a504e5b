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

from fem_snh import _dolfinx, scenes
from fem_snh.accuracy.goal_errors import Estimate, GoalError, Place
from fem_snh.accuracy.levels import LevelRow, Levels
from fem_snh.accuracy.refinement import Lineage
from fem_snh.arrays import Array
from fem_snh.errors import BadInput, on_root
from fem_snh.files import replace_file
from fem_snh.mesh.gmsh_model import MeshData, PhysicalGroup
from fem_snh.mesh.mesh import Mesh, distribute, gather, of_input_cells
from fem_snh.mesh.round_faces import RoundFaces
from fem_snh.records.run_files import LEVELS
from fem_snh.records.run_record import load_record
from fem_snh.runs.folder import Folder
from fem_snh.runs.scene_options import check_same, identity

#: Key of the number of an array in the archive, in a mapping that stands for the array in JSON.
_NUMBER = "array of the archive"


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
    last = levels.rows[-1]
    about = {
        "scene": _identity(scene),
        "rows": [asdict(_without_indicators(row)) for row in levels.rows],
        "changes": dict(changes),
        "errors": {n: of_input_cells(domain, v) for n, v in last.estimate.indicators.items()},
        "lineage": lineage,
        "mesh": gather(mesh) if mesh else None,
        "round_faces": mesh.round_faces if mesh else None,
    }
    arrays: list[Array] = []

    def to_json(value: Any) -> Any:
        if not isinstance(value, np.ndarray):
            return value.item()  # a number of numpy
        arrays.append(value)
        return {_NUMBER: len(arrays) - 1}

    def write() -> None:
        text = json.dumps(about, default=to_json).encode()
        archive = BytesIO()
        np.savez(archive, *arrays, about=np.frombuffer(text, np.uint8))
        replace_file(folder.path / LEVELS, lambda file: file.write(archive.getbuffer()), sync=True)

    on_root(folder.comm, write)


def read_levels(folder: Folder, scene: scenes.Scene) -> StoredLevels | None:
    """Return the levels of a folder; None if no level was finished. Collective.

    Raises
    ------
    BadInput
        On every rank, for a folder with another run, or a file that cannot be read.
    """
    path, kept = folder.path / LEVELS, dict[str, Any]()

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
                about: dict[str, Any] = json.loads(
                    stored["about"].tobytes(),
                    object_hook=lambda d: stored[f"arr_{d[_NUMBER]}"] if _NUMBER in d else d,
                )
            about["rows"] = [_row(row) for row in about["rows"]]
            kept.update({key: about.pop(key) for key in ("scene", "mesh", "lineage")})
        except Exception as error:  # zipfile, zlib, numpy and json raise different ones
            reason = str(error) or type(error).__name__
            raise BadInput(
                f"{path} cannot be read ({reason}): start again with --overwrite"
            ) from None
        check_same(folder.path, kept["scene"], _identity(scene))
        return about | {"has_mesh": kept["mesh"] is not None}

    def make() -> MeshData:
        data = MeshData(*kept["mesh"])
        return data._replace(groups=[PhysicalGroup(*group) for group in data.groups])

    about = on_root(folder.comm, read)
    if about is None:
        return None
    mesh, faces = None, about["round_faces"]
    if about["has_mesh"]:
        mesh = distribute(folder.comm, str(path), make)
        mesh = replace(mesh, round_faces=RoundFaces(*faces) if faces else None)
    lineage = Lineage(*kept["lineage"]) if kept.get("lineage") else None
    return StoredLevels(about["changes"], mesh, lineage, about["rows"], about["errors"])


def _identity(scene: scenes.Scene) -> dict[str, Any]:
    """Return the values that must not change between the levels, by dotted keys."""
    wanted = scene.accuracy
    assert wanted
    goals = [g.name if g.at is None else f"{g.name} at {g.at}" for g in wanted.goals]
    asked = {"accuracy.keep_element": wanted.keep_element, "accuracy.goals": goals}
    return identity(scene) | asked


def _without_indicators(row: LevelRow) -> LevelRow:
    """Return a level's row without the errors in its cells."""
    return replace(row, estimate=replace(row.estimate, indicators={}))


def _row(record: dict[str, Any]) -> LevelRow:
    """Return a level's row from its values."""
    found = record["estimate"]
    places = {n: Place(**p | {"largest": tuple(p["largest"])}) for n, p in found["places"].items()}
    errors = {name: GoalError(**goal) for name, goal in found["goals"].items()}
    estimate = Estimate(**found | {"goals": errors, "places": places})
    goals = {name: GoalError(**goal) for name, goal in record["goals"].items()}
    return LevelRow(**record | {"estimate": estimate, "goals": goals})
