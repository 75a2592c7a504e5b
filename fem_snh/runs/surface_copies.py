"""Copies of the surfaces of a scene's solids in the folder of its run, for pictures."""

from __future__ import annotations

import shutil
from functools import partial
from pathlib import Path

from fem_snh.errors import BadInput
from fem_snh.files import replace_file
from fem_snh.records.run_files import SOLIDS, surface_copy
from fem_snh.runs.folder import Folder
from fem_snh.scenes import Scene


def copy_surfaces(scene: Scene, folder: Folder) -> None:
    """Copy the surfaces of obstacles, bones and rigid parts that are files. On rank 0.

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
    folder.announce(name)
    try:
        with source.open("rb") as file:
            replace_file(folder.path / name, partial(shutil.copyfileobj, file))
    except OSError as error:
        raise BadInput(f"cannot read {source}: {error.strerror}") from None
