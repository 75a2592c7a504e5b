"""What run.json and the folder of a run have of its obstacles, so that pictures can show them."""

from __future__ import annotations

import shutil
from functools import partial
from typing import Any

from fem_snh.atomic_files import replace_file
from fem_snh.errors import BadInput
from fem_snh.problem.problem import Problem
from fem_snh.runs.folder import Folder
from fem_snh.scenes import BoneChoice, Scene, obstacle_names


def describe_obstacles(scene: Scene, problem: Problem) -> dict[str, dict[str, Any]]:
    """Return the obstacles of a scene by name, as run.json has them before the first step.

    Each has its ``shape``, a table of one key as in the scene (a surface by its file's name in the
    folder), ``friction``, ``method``, and ``pose``, the three rows [R | c] of its pose at load 0.
    """
    term: Any = next(term for term in problem.terms if term.name == "obstacle")
    found = {}
    for i, name in enumerate(obstacle_names(scene.obstacle)):
        choice = scene.obstacle[i]
        found[name] = {
            "shape": choice.shape.record() if choice.shape else {"surface": _file_name(i)},
            "friction": choice.friction,
            "method": choice.method,
            "pose": term.contacts[i].obstacle.affine(0.0),
        }
    return found


def copy_surfaces(scene: Scene, folder: Folder) -> None:
    """Copy the surfaces of obstacles and bones to the folder of a run. On rank 0.

    Raises
    ------
    BadInput
        If a file cannot be read or written.
    """
    files = {_file_name(i): choice.surface for i, choice in enumerate(scene.obstacle)}
    files |= {surface_name(scene, choice): choice.surface for choice in scene.bone}
    for name, path in files.items():
        if path is not None:
            folder.announce(name)
            try:
                with path.open("rb") as source:
                    replace_file(folder.path / name, partial(shutil.copyfileobj, source))
            except OSError as error:
                raise BadInput(f"cannot read {path}: {error.strerror}") from None


def surface_name(scene: Scene, bone: BoneChoice) -> str:
    """Return the name of the file of a bone's surface in the folder of a run."""
    kind = bone.surface.suffix.lower() if bone.surface else ""
    return f"bone_{scene.bone.index(bone)}{kind}"


def _file_name(number: int) -> str:
    """Return the name of an obstacle's STL file in the folder of a run."""
    return f"obstacle_{number}.stl"
