"""The entries of a scene's bones in run.json, and copies of surface files."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

from fem_snh.errors import BadInput
from fem_snh.files import replace_file
from fem_snh.problem.bones import BoneNodes
from fem_snh.problem.problem import Problem
from fem_snh.records.run_files import SOLIDS, surface_copy
from fem_snh.records.run_record import Record
from fem_snh.runs.folder import Folder
from fem_snh.scenes import Scene
from fem_snh.tables.shapes import shape_record


def describe_bones(scene: Scene, problem: Problem) -> dict[str, Record]:
    """Return the entry of each bone in run.json before the first step, by name. Collective.

    An entry has the bone's ``shape``, a table of one key as in the scene, or ``group``; the number
    of ``nodes``; the ``length``; and ``pose``, the rows [A | c] of the map x = A X + c at load 0.
    """
    found = {}
    placed: list[BoneNodes] = problem.dirichlet.bones
    for i, (choice, bone) in enumerate(zip(scene.bone, placed, strict=True)):
        kind: Record = {"group": choice.group}
        if solid := choice.shape or choice.surface:
            kind = {"shape": shape_record("bone", i, solid)}
        pose = bone.affine(0.0).tolist()
        found[choice.name] = {**kind, "nodes": bone.count, "length": bone.length, "pose": pose}
    return found


def copy_surfaces(scene: Scene, folder: Folder) -> None:
    """Copy the surface files of obstacles, bones and rigid parts to the folder. On rank 0.

    Raises
    ------
    BadInput
        If a file cannot be read or written.
    """
    for solid in SOLIDS:
        for number, table in enumerate(getattr(scene, solid)):
            if table.surface is not None:
                _copy(table.surface, folder, surface_copy(solid, number, table.surface))


def _copy(source: Path, folder: Folder, name: str) -> None:
    try:
        with source.open("rb") as file:
            replace_file(folder.path / name, partial(shutil.copyfileobj, file))
    except OSError as error:
        raise BadInput(f"cannot read {source}: {error.strerror}") from None
