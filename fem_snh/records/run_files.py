"""The files of a run in its folder: their names, and the lock of the folder.

A file belongs to the run if it has a name that runs write (`is_run_file`), whatever process has
written it. Files of other names are never removed. run.json lists the run's files under ``files``.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from pathlib import Path

from fem_snh.errors import BadInput
from fem_snh.files import read_text, remove, remove_leftovers

#: File name of the checkpoint.
CHECKPOINT = "checkpoint.npz"
#: File name of the finished levels of a run to an accuracy, and of the folder of the next level.
LEVELS, NEXT_LEVEL = "levels.npz", "next_level"
#: File name of the lock.
LOCK = ".lock"
#: Names of collections (.pvd), whose states have files of the same stem.
COLLECTIONS = ("fields", "skin", "obstacles", "modes")
#: Files of which a run has one each.
_SINGLE = (
    "run.json",
    "steps.csv",
    "modes.csv",
    CHECKPOINT,
    LEVELS,
    *(f"{c}.pvd" for c in COLLECTIONS),
)
#: The tables of scenes whose surface may be a file, of which the run's folder has a copy.
SOLIDS = ("obstacle", "bone", "rigid")
#: Names of the numbered files: states of collections, and copies of surfaces.
_NUMBERED = re.compile(
    rf"({'|'.join(COLLECTIONS)})(_p\d+_)?\d{{6,}}\.p?vtu|({'|'.join(SOLIDS)})_\d+\.(stl|obj)"
)
#: File names that a message lists.
_SHOWN = 3


def is_run_file(name: str) -> bool:
    """Return whether a run may write a file of this name."""
    return name in _SINGLE or _NUMBERED.fullmatch(name) is not None


def surface_copy(solid: str, number: int, source: Path) -> str:
    """Return the name of a surface's copy in the folder of a run, for example "rigid_0.obj".

    ``solid`` is one of `SOLIDS`; ``number`` counts its tables from 0. Readers tell OBJ files by
    their suffix; every other file is STL.
    """
    return f"{solid}_{number}{'.obj' if source.suffix.lower() == '.obj' else '.stl'}"


def run_files(folder: Path) -> list[str]:
    """Return the names of a run's files in a folder, sorted."""
    return sorted(name for name in os.listdir(folder) if is_run_file(name))


def remove_run(folder: Path) -> None:
    """Remove the files of a run, then its folder if that is empty.

    Raises BadInput if a process still writes into the folder.
    """
    with closing(FolderLock(folder / LOCK)):
        for name in run_files(folder):
            remove(folder / name)
    with suppress(OSError):
        folder.rmdir()


def take_run(folder: Path, other: Path) -> None:
    """Replace the run in ``folder`` by the complete run in ``other``; remove ``other``.

    `LEVELS` is moved last. If the process is killed before, ``other`` still has `LEVELS`, which
    marks a complete run, and the call can be repeated.
    """
    last = ("run.json", LEVELS)
    if (other / "run.json").exists():
        names = json.loads(read_text(other / "run.json"))["files"]
        for name in set(run_files(folder)) - {*names, *last}:
            remove(folder / name)
    for name in [*(name for name in run_files(other) if name not in last), *last]:
        with suppress(FileNotFoundError):  # taken before the process was killed
            (other / name).replace(folder / name)
    remove_run(other)


class FolderLock:
    """An exclusive lock of a folder, on an empty file in the folder.

    The operating system releases the lock when the process ends, however it ends.

    Parameters
    ----------
    path : Path
        The file, which is created.

    Attributes
    ----------
    note : str
        "" if the folder is locked; else why not, as its file system may have no locks.

    Raises
    ------
    BadInput
        If another process holds the lock, or the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.note = path, ""
        while True:
            try:
                self.file = path.open("ab")
            except OSError as error:
                raise BadInput(
                    f"output folder {path.parent} cannot be written ({error.strerror}): "
                    "choose another"
                ) from None
            try:
                fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                self.file.close()
                raise BadInput(
                    f"out = {path.parent}: another process writes into this folder: expected "
                    "another folder, or the end of that process"
                ) from None
            except OSError as error:  # e.g. Lustre mounted without flock
                self.note = (
                    f"{path.parent} is not locked ({error.strerror}): two runs at a time would "
                    "write into it unnoticed"
                )
            # The process that held the lock may have removed the file since it was opened.
            with suppress(FileNotFoundError):
                if path.stat().st_ino == os.fstat(self.file.fileno()).st_ino:
                    return
            self.file.close()

    def close(self) -> None:
        """Release the lock and remove its file; nothing if it was released before."""
        if not self.file.closed:
            remove(self.path)
            self.file.close()


def lock_run(
    folder: Path, inputs: Iterable[Path] = (), overwrite: bool = False, resume: bool = False
) -> FolderLock:
    """Return the lock of an existing folder for a run that writes into it.

    Temporary files of killed runs in the folder are removed.

    Parameters
    ----------
    folder : Path
        The folder.
    inputs : iterable of Path
        The files that the run reads.
    overwrite, resume : bool
        Accept a folder that is not empty; with ``resume`` only one that holds a run, or nothing but
        files that a run wrote before it was killed.

    Raises
    ------
    BadInput
        If another process writes into the folder, if the folder holds files that neither flag
        accepts, or if the run might replace one of its inputs.
    """
    lock = FolderLock(folder / LOCK)
    try:
        if not overwrite:
            _check_files(folder, resume)
        check_inputs(folder, inputs)
    except BadInput:
        lock.close()
        raise
    remove_leftovers(folder, is_run_file)
    return lock


def _check_files(folder: Path, resume: bool) -> None:
    """Raise BadInput if a folder holds a run that is not resumed, or files of no run."""
    holds_run = (folder / "run.json").exists()
    if holds_run and not resume:
        raise BadInput(
            f"{folder} already holds a run: give --overwrite or another --out, "
            "or continue it with --resume"
        )
    if not holds_run and (others := list_others(folder, is_run_file if resume else None)):
        raise BadInput(
            f"out = {folder}: holds files of no run ({others}): expected an empty folder, or "
            "--overwrite, which removes only files of names that a run writes"
        )


def list_others(folder: Path, is_known: Callable[[str], bool] | None = None) -> str:
    """Return the first names in a folder that are not hidden, with commas between; or "".

    Names for which ``is_known`` is true are left out.
    """
    if not folder.is_dir():
        return ""
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    names = [name for name in names if not (is_known and is_known(name))]
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def check_inputs(
    folder: Path, inputs: Iterable[Path], is_output: Callable[[str], bool] = is_run_file
) -> None:
    """Raise BadInput if output in this folder might replace an input, or the file it links to.

    ``is_output`` returns whether a file of a name may be written.
    """
    for path in inputs:
        for file in (path.resolve(), path.parent.resolve() / path.name):
            if file.parent == folder.resolve() and is_output(file.name):
                raise BadInput(
                    f"out = {folder}: files of the name of the input {path.name} are written "
                    "there: expected another folder"
                )
