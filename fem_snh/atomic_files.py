"""Replace files as a whole: a reader finds the old content or the new one.

All output of runs and studies is written here.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from fem_snh.errors import BadInput, bad_value


def output_path(key: str, path: str | Path) -> Path:
    """Return the path that a user gave for output.

    Raises
    ------
    BadInput
        For an empty text, which would be the working directory, and for one with a null byte.
    """
    text = os.fspath(path)
    if not text.strip() or "\0" in text:
        raise bad_value(key, text, "a path; '.' is the working directory")
    return Path(text)


def make_folder_of(path: Path) -> None:
    """Create the folder of a file that is to be written; raise BadInput if that fails."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror or error}") from None


def replace_file(
    path: Path, content: str | Callable[[BinaryIO], object], sync: bool = False
) -> None:
    """Replace a file as a whole.

    The content is written beside ``path`` under a hidden name, and the file is then moved there.

    Parameters
    ----------
    path : Path
        The file.
    content : str or callable
        A text, or a function that writes to the binary file that it is given, and may read it.
    sync : bool
        Wait until the content is on the disk, so that it survives a loss of power.

    Raises
    ------
    BadInput
        If the file cannot be written, as on a full disk; an earlier file is unchanged.
    """
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("w+b") as file:
            if isinstance(content, str):
                file.write(content.encode())
            else:
                content(file)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        os.replace(new, path)
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        remove(new)


def check_whole(written: Path, path: Path, ending: bytes) -> None:
    """Raise BadInput if a file that a library has written does not end with ``ending``.

    Libraries need not report a full disk. ``path`` is the file's name in the message.
    """
    reason = "it was cut short"
    try:
        if written.exists():
            with written.open("rb") as file:
                file.seek(0, os.SEEK_END)
                file.seek(max(0, file.tell() - len(ending) - 16))
                if file.read().rstrip().endswith(ending):
                    return
        with written.open("ab") as file:  # fails for the reason for which the library failed
            file.write(b" " * 65536)
    except OSError as error:
        reason = error.strerror or str(error)
    raise BadInput(f"cannot write {path}: {reason}")


def remove(path: Path) -> None:
    """Remove a file if it exists; ignore errors."""
    try:
        path.unlink(missing_ok=True)
    except OSError:
        pass  # a remaining file does no harm
