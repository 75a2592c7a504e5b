"""Points of a study that are runs of scenes."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fem_snh import scenes
from fem_snh.files import file_digest
from fem_snh.references import file_of
from fem_snh.studies.point import Point
from fem_snh.studies.table import REQUESTED, measured_columns


@dataclass(frozen=True)
class ScenePoint(Point):
    """A run of a scene by ``fem-snh run``.

    Parameters
    ----------
    name : str | Path
        Name of the scene, or its .toml file.
    values : mapping
        Keyword arguments of `fem_snh.scenes.load`.
    scene : scenes.Scene
        The scene loaded with these values.
    petsc : mapping
        PETSc options, without the dash.
    """

    name: str | Path
    values: Mapping[str, Any]
    scene: scenes.Scene
    petsc: Mapping[str, Any] = field(default_factory=dict)

    def arguments(self, folder: Path) -> list[str]:
        """Return the arguments of ``fem-snh``."""
        return run_arguments(self.name, folder, self.values, self.petsc)

    def files(self) -> list[Path]:
        """Return the files of the scene."""
        return scene_files(self.name, [self.scene])

    def requested(self) -> Mapping[str, Any]:
        """Return its values and the columns REQUESTED."""
        return {**self.values, **requested_columns(self.scene)}

    def measured(self, record: Mapping[str, Any], log: Path, code: int) -> Mapping[str, Any]:
        """Return the columns MEASURED."""
        return measured_columns(record, log, code)


def run_arguments(
    scene: str | Path, folder: Path | None, values: Mapping[str, Any], petsc: Mapping[str, Any]
) -> list[str]:
    """Return the arguments of ``fem-snh`` for a run with these values and PETSc options.

    Without a folder the run writes nothing.
    """
    arguments = ["run", str(scene), "--quiet"]
    arguments += ["--out", str(folder), "--overwrite"] if folder is not None else []
    arguments += [f"--set={key}={json.dumps(v)}" for key, v in values.items()]
    options = [[f"-{k}"] if v is None else [f"-{k}", value_text(v)] for k, v in petsc.items()]
    return [*arguments, "--", *itertools.chain(*options)]


def value_text(value: Any) -> str:
    """Return a value as it is written on the command line."""
    return value if isinstance(value, str) else json.dumps(value)


def requested_columns(scene: scenes.Scene) -> dict[str, Any]:
    """Return the settings of a scene as the columns REQUESTED."""
    values = {key: getattr(scene, key) for key in REQUESTED if key not in ("scene", "E", "nu")}
    materials = {key: [getattr(m, key) for m in scene.materials] for key in ("name", "E", "nu")}
    name, E, nu = (v[0] if len(v) == 1 else _joined(v) for v in materials.values())
    return values | {"scene": scene.name, "material": name, "E": E, "nu": nu}


def _joined(values: Iterable[Any]) -> str:
    """Return the values of several materials as text."""
    return " + ".join(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def scene_files(scene: str | Path, loaded: Iterable[scenes.Scene]) -> list[Path]:
    """Return the files of a scene: its own, and those that it reads."""
    paths = {file_of(str(scene))}
    for each in loaded:
        paths |= set(each.files.values())
    return [path for path in sorted(paths) if path.suffix]


def file_digests(scene: str | Path, loaded: Iterable[scenes.Scene]) -> dict[str, str]:
    """Return a digest of each file of a scene, by which a study detects other contents."""
    return {str(path): file_digest(path) for path in scene_files(scene, loaded)}
