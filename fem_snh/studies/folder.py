"""The folder of a study: its definition, what each of its rows depends on, and its points."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from fem_snh import cache
from fem_snh.errors import BadInput
from fem_snh.files import (
    file_digest,
    output_path,
    read_text,
    remove,
    remove_leftovers,
    replace_file,
)
from fem_snh.records.run_files import FolderLock, RunFiles, check_inputs, list_others
from fem_snh.studies.point import Point

#: The log of a point.
LOG = "log.txt"
#: How a point ended that a job of a scheduler ran (`fem_snh.studies.tasks.End`).
END = "end.json"
#: Hidden file that is the lock of the folder.
_LOCK = ".study"
#: Key of the definition that has the points: what the row of each depends on.
_POINTS = "points"


class StudyFolder:
    """The folder of a study, which is created, and which one process at a time may use.

    NAME.json holds the definition and the names of the points before a point writes anything, so
    that no other folder is ever taken for one of a point.

    Parameters
    ----------
    out : str or Path
        The folder.
    name : str
        Name of the study.
    definition : mapping
        The values that all rows of the table share.
    inputs : iterable of Path
        Files that the study reads.
    overwrite : bool
        Delete an earlier study in ``out``; accept a folder that holds other files, which stay.

    Raises
    ------
    BadInput
        If ``out`` holds a study of another definition, or files of no study, and ``overwrite`` is
        false; if it holds an input that the study would replace; if another process uses it, or it
        cannot be written.
    """

    def __init__(
        self,
        out: str | Path,
        name: str,
        definition: Mapping[str, Any],
        inputs: Iterable[Path],
        overwrite: bool,
    ) -> None:
        self.path, self.name = output_path("out", out), name
        self._record = self.path / f"{name}.json"
        self._definition = json.loads(json.dumps(definition))
        try:
            self.path.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise BadInput(f"out = {out}: cannot be written: {error.strerror}") from None
        check_inputs(self.path, inputs, lambda file: Path(file).stem == name)
        self._lock = FolderLock(self.path / _LOCK)
        self.note = self._lock.note
        remove_leftovers(self.path, lambda file: Path(file).stem == name)
        try:
            self._points = self._open(overwrite)
        except BaseException:
            self.close()
            raise
        self._write()

    def _open(self, overwrite: bool) -> dict[str, Any]:
        """Return what the rows of an earlier study depend on; refuse or remove one."""
        earlier = self._earlier()
        if earlier is None:
            others = list_others(self.path)
            if others and not overwrite:
                raise BadInput(
                    f"out = {self.path}: holds what is not of a {self.name} study ({others}): "
                    "expected a new or an empty folder, or --overwrite"
                )
            earlier = {}
        points = earlier.pop(_POINTS, {})
        points = points if isinstance(points, dict) else {}
        if overwrite:
            for point in points:
                self.discard(point)
            remove(self.path / f"{self.name}.csv")
            return {}
        if earlier and earlier != self._definition:
            keys = dict.fromkeys([*self._definition, *filter(None, earlier)])
            other = [k for k in keys if earlier.get(k) != self._definition.get(k)]
            raise BadInput(
                f"out = {self.path}: holds {self.name}.csv of other {', '.join(other)}: "
                "expected another folder, or --overwrite"
            )
        return points

    def _earlier(self) -> dict[str, Any] | None:
        """Return the content of NAME.json; None without one, {"": text} if it cannot be read."""
        unreadable = {"": "text that is no definition"}
        try:
            found = json.loads(read_text(self._record))
        except FileNotFoundError:
            return None
        except (OSError, ValueError, RecursionError):
            return unreadable
        return found if isinstance(found, dict) and found else unreadable

    def _write(self) -> None:
        text = json.dumps(self._definition | {_POINTS: self._points}, indent=1)
        replace_file(self._record, text)

    def register(self, points: Mapping[str, Point], rows: Iterable[str]) -> None:
        """Note what points depend on, before any of them writes.

        Parameters
        ----------
        points : mapping
            The points by name.
        rows : iterable of str
            The points that have a row already.

        Raises
        ------
        BadInput
            If a row depends on other values or on other contents of a file than its point, or the
            folder of a point is not that of a point of this study.
        """
        known, now = set(rows), {name: _dependencies(point) for name, point in points.items()}
        for name, found in now.items():
            before = self._points.get(name)
            if before is None:
                if list_others(self.path / name):
                    raise BadInput(
                        f"out = {self.path}: its folder {name} is not one of this study: expected "
                        "another folder"
                    )
            elif name in known and before != found:
                before = before if isinstance(before, dict) else {}
                keys = dict.fromkeys([*found, *before])
                other = [key for key in keys if before.get(key) != found.get(key)]
                raise BadInput(
                    f"out = {self.path}: {name} in {self.name}.csv was computed with other "
                    f"{', '.join(other)}: expected another folder, or --overwrite"
                )
        if new := {name: found for name, found in now.items() if self._points.get(name) != found}:
            self._points |= new
            self._write()

    def begin(self, name: str) -> Path:
        """Return the folder of a registered point, without what an earlier run of it has left."""
        return clear_point(self.path, name)

    def discard(self, name: str) -> None:
        """Remove the files of a point."""
        _remove_point(self.path, name)

    def close(self) -> None:
        """Release the folder for other processes."""
        self._lock.release()


def clear_point(out: Path, name: str) -> Path:
    """Return the folder of a point of the study in ``out``, empty but for files of others.

    Raises BadInput if a process still writes into it.
    """
    _remove_point(out, name)
    folder = out / name
    folder.mkdir(exist_ok=True)
    return folder


def _remove_point(out: Path, name: str) -> None:
    """Remove the files of a point, and its folder unless it holds others."""
    folder = out / name
    if Path(name).name != name or not folder.is_dir() or folder.is_symlink():
        return  # a name that was edited, or a point that has not run
    run = RunFiles(folder, overwrite=True)
    run.discard(list(run.names))
    run.close()
    for file in (LOG, END):
        remove(folder / file)
    with suppress(OSError):
        folder.rmdir()


def _dependencies(point: Point) -> dict[str, str]:
    """Return digests of what a point's row depends on: its command, and files by their paths."""
    command = cache.key(point.module, point.arguments(Path()))
    return {"values": command} | {str(path): file_digest(path) for path in point.files()}
