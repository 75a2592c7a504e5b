"""What run.json and the folder of a run have of its obstacles, so that pictures can show them."""

from __future__ import annotations

import shutil
from functools import partial

from fem_snh.atomic_files import replace_file
from fem_snh.contact.obstacle import file_name
from fem_snh.errors import BadInput
from fem_snh.runs.folder import Folder
from fem_snh.scenes import BoneChoice, Scene
from fem_snh.terms import rigid


def copy_surfaces(scene: Scene, folder: Folder) -> None:
    """Copy the surfaces of obstacles, bones and rigid parts to the folder of a run. On rank 0.

    Raises
    ------
    BadInput
        If a file cannot be read or written.
    """
    files = {file_name(i): choice.surface for i, choice in enumerate(scene.obstacle)}
    files |= {surface_name(scene, choice): choice.surface for choice in scene.bone}
    files |= {rigid.file_name(i, part): part.surface for i, part in enumerate(scene.rigid)}
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
