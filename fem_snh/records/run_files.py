"""The files of a run in its folder: their names, the list of them, and the lock of the folder.

run.json lists the files of a run under ``files``. Until the run ends, the hidden file `LIST` lists
them too, each before it is written: the files of a killed run are known as well, and nothing else
in the folder is ever removed.
"""

from __future__ import annotations

import fcntl
import json
import os
import re
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from fem_snh.errors import BadInput
from fem_snh.files import check_regular, read_text, remove, remove_leftovers

#: File name of the checkpoint.
CHECKPOINT = "checkpoint.npz"
#: File name of the finished levels of a run to an accuracy, and of the folder of the next level.
LEVELS, NEXT_LEVEL = "levels.npz", "next_level"
#: File name of the list of a run that has not ended, which is also its lock.
LIST = ".files"
#: Names of collections (.pvd), whose states have files of the same stem.
COLLECTIONS = ("fields", "skin", "obstacles", "modes")
#: Files of which a run has one each. A record without a list is that of an older version.
_SINGLE = (
    "run.json",
    "steps.csv",
    "modes.csv",
    CHECKPOINT,
    LEVELS,
    *(f"{c}.pvd" for c in COLLECTIONS),
)
#: The solids whose surfaces may be files, of which a run has copies: the tables of scenes.
SOLIDS = ("obstacle", "bone", "rigid")
#: The other files: states of collections, these copies, and what PETSc's viewers write.
_NUMBERED = re.compile(
    rf"({'|'.join(COLLECTIONS)})(_p\d+_)?\d{{6,}}\.p?vtu|({'|'.join(SOLIDS)})_\d+\.(stl|obj)"
    r"|petsc_[\w.+-]+"
)
#: File names that a message lists.
_SHOWN = 3


def is_run_file(name: str) -> bool:
    """Return whether a run may write a file of this name."""
    return name in _SINGLE or _NUMBERED.fullmatch(name) is not None


def surface_copy(solid: str, number: int, source: Path) -> str:
    """Return the name of the copy of a solid's surface, "rigid_0.obj", in the folder of a run.

    Readers tell OBJ files by their suffix; every other file is STL.
    """
    return f"{solid}_{number}{'.obj' if source.suffix.lower() == '.obj' else '.stl'}"


def viewer_file(name: str) -> str:
    """Return the name, in the folder of a run, of a file that a viewer of PETSc writes."""
    return f"petsc_{name}"


def listed_files(folder: Path) -> list[str] | None:
    """Return the files that a run lists as its own; None if the folder holds no run."""
    record, listed = _record(folder), _listed(folder / LIST)
    if record is None and not listed:
        return None
    files = (record or {}).get("files", _SINGLE if record else ())
    names = [*(files if isinstance(files, list | tuple) else ()), *listed]
    # The names are checked as well: a list that was edited removes no other file.
    return [name for name in dict.fromkeys(names) if isinstance(name, str) and is_run_file(name)]


def _listed(path: Path) -> list[str]:
    """Return the complete lines of a `LIST`; none if there is no such file."""
    try:
        text = read_text(path, errors="replace")
    except OSError:
        return []
    return text[: text.rfind("\n") + 1].splitlines()


def _record(folder: Path) -> dict[str, Any] | None:
    """Return the content of run.json if it is the record of a run, else None."""
    try:
        record = json.loads(read_text(folder / "run.json"))
    except (OSError, ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) and {"scene", "steps"} <= record.keys() else None


class FolderLock:
    """The lock of a folder that one process writes into, on a file in it.

    The system releases it when the process ends, however it ends.

    Parameters
    ----------
    path : Path
        The file; it is created.

    Attributes
    ----------
    file : BinaryIO
        The file, which may hold data.
    note : str
        Why the folder is not locked: "", or that its file system has no locks.

    Raises
    ------
    BadInput
        If another process holds the lock, or the file cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.note = path, ""
        while True:
            try:
                # No link is followed to another file, and no FIFO waited for.
                flags = os.O_RDWR | os.O_CREAT | os.O_APPEND | os.O_NOFOLLOW | os.O_NONBLOCK
                self.file = open(os.open(path, flags, 0o666), "a+b", buffering=0)
                check_regular(path)
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

    def release(self, keep: bool = False) -> None:
        """Release the lock; remove the file, unless it is to be kept."""
        if not self.file.closed:
            if not keep:
                remove(self.path)
            self.file.close()


class RunFiles:
    """The files of a run that writes into a folder: their list and the lock of the folder.

    Only rank 0 has it.

    Parameters
    ----------
    folder : Path
        The folder, which exists.
    inputs : iterable of Path
        The files that the run reads.
    overwrite, resume : bool
        Accept a folder that holds a run, to replace or to continue it; with ``overwrite`` also a
        folder that holds other files.

    Attributes
    ----------
    note : str
        See `FolderLock`.

    Raises
    ------
    BadInput
        If another process writes into the folder, if the folder is neither empty nor accepted, or
        if the run would replace one of its inputs.
    """

    def __init__(
        self,
        folder: Path,
        inputs: Iterable[Path] = (),
        overwrite: bool = False,
        resume: bool = False,
    ) -> None:
        self.folder = folder
        self._lock = FolderLock(folder / LIST)
        self.note = self._lock.note
        earlier = listed_files(folder)
        try:
            if not (overwrite or resume):
                _check_empty(folder, earlier)
            check_inputs(folder, inputs)
        except BadInput:
            self._lock.release(keep=earlier is not None)
            raise
        remove_leftovers(folder, is_run_file)
        #: The names, as keys, in the order in which they were listed.
        self.names = dict.fromkeys(earlier or ())
        self._recorded = set(self.names) - set(_listed(folder / LIST))

    def add(self, names: Iterable[str]) -> None:
        """List files before they are written."""
        new = [name for name in names if name not in self.names]
        if new:
            self._lock.file.write("".join(f"{name}\n" for name in new).encode())
            self.names |= dict.fromkeys(new)

    def discard(self, names: Iterable[str]) -> None:
        """Remove files that are listed."""
        for name in [name for name in names if name in self.names]:
            remove(self.folder / name)
            del self.names[name]

    def take(self, other: RunFiles) -> None:
        """Replace the files by those of another run, from another folder, which is removed.

        `LEVELS`, which makes that run complete, comes last: a killed process has not begun to take
        the files, or its folder has `LEVELS` and the rest of them.
        """
        self.discard([name for name in self.names if name not in other.names])
        self.add(other.names)
        last = ("run.json", LEVELS)
        for name in [*(name for name in other.names if name not in last), *last]:
            with suppress(FileNotFoundError):  # taken before the process was killed
                (other.folder / name).replace(self.folder / name)
        other.remove()

    def remove(self) -> None:
        """Remove the files, and the folder if it is empty then."""
        self.discard(list(self.names))
        self.close()
        with suppress(OSError):
            self.folder.rmdir()

    def note_recorded(self) -> None:
        """Note that run.json has the list as it is now."""
        self._recorded = set(self.names)

    def close(self) -> None:
        """Release the folder; `LIST` remains unless run.json has all of it."""
        self._lock.release(keep=not self.names.keys() <= self._recorded)


def _check_empty(folder: Path, earlier: list[str] | None) -> None:
    """Raise BadInput if a folder holds a run, or anything else that is not hidden."""
    if earlier is not None or (folder / "run.json").exists():
        raise BadInput(
            f"{folder} already holds a run: give --overwrite or another --out, "
            "or continue it with --resume"
        )
    if others := list_others(folder):
        raise BadInput(
            f"out = {folder}: holds files of no run ({others}): expected an empty folder, or "
            "--overwrite, which replaces only files of names that a run writes"
        )


def list_others(folder: Path) -> str:
    """Return the first names in a folder that are not hidden, as text; "" if there are none."""
    if not folder.is_dir():
        return ""
    names = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
    return ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")


def check_inputs(
    folder: Path, inputs: Iterable[Path], is_output: Callable[[str], bool] = is_run_file
) -> None:
    """Raise BadInput if output in this folder might replace a file that is read for it."""
    for path in inputs:
        for file in (path.resolve(), path.parent.resolve() / path.name):
            if file.parent == folder.resolve() and is_output(file.name):
                raise BadInput(
                    f"out = {folder}: files of the name of the input {path.name} are written "
                    "there: expected another folder"
                )
