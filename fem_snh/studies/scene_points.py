"""The points of a study that are runs of scenes."""

from __future__ import annotations

import hashlib
import itertools
import json
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from fem_snh import scenes
from fem_snh.studies.campaign import Point
from fem_snh.studies.table import ASKED, found


@dataclass(frozen=True)
class ScenePoint(Point):
    """A run of a scene: ``fem-snh run``.

    Attributes:
        name: of the scene, or its .toml file.
        values: as `fem_snh.scenes.load` takes them.
        scene: what it made of them.
        petsc: PETSc options, without the dash.
    """

    name: str | Path
    values: Mapping[str, Any]
    scene: scenes.Scene
    petsc: Mapping[str, Any] = field(default_factory=dict)

    def words(self, folder: Path) -> list[str]:
        return arguments(self.name, folder, self.values, self.petsc)

    def asked(self) -> Mapping[str, Any]:
        return {**self.values, **asked(self.scene)}

    def found(self, record: Mapping[str, Any], log: Path, code: int) -> Mapping[str, Any]:
        return found(record, log, code)


def arguments(
    scene: str | Path, folder: Path, values: Mapping[str, Any], petsc: Mapping[str, Any]
) -> list[str]:
    """The words after ``fem-snh`` for one point."""
    words = ["run", str(scene), "--out", str(folder), "--quiet"]
    words += [f"--set={key}={json.dumps(v)}" for key, v in values.items()]
    options = [[f"-{k}"] if v is None else [f"-{k}", text(v)] for k, v in petsc.items()]
    return [*words, "--", *itertools.chain(*options)]


def text(value: Any) -> str:
    """A value as one writes it on the command line."""
    return value if isinstance(value, str) else json.dumps(value)


def asked(scene: scenes.Scene) -> dict[str, Any]:
    """What a scene says, as the columns ASKED."""
    values = {key: getattr(scene, key) for key in ASKED if key not in ("scene", "E", "nu")}
    material = scene.material
    return values | {
        "scene": scene.name, "material": material.name, "E": material.E, "nu": material.nu
    }  # fmt: skip


def digests(scene: str | Path, loaded: Iterable[scenes.Scene]) -> dict[str, str]:
    """What the files of a scene hold: with other contents, it is another study."""
    paths = {Path(scene), *(s.mesh for s in loaded if isinstance(s.mesh, Path))}
    return {str(p): _digest(p) for p in sorted(paths) if p.suffix}


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()[:16]
