"""Files that are old or new, never half."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO

from fem_snh.errors import BadInput


def put(path: Path, content: str | Callable[[BinaryIO], object], sync: bool = False) -> None:
    """Put a text, or what a function writes to a binary file, into ``path`` in one go.

    It is written beside ``path`` under a hidden name and moved there, with ``sync`` once it is on
    the disk, so that it outlives a loss of power. BadInput if it cannot be, as on a full disk; an
    earlier file is then as it was.
    """
    new = path.with_name(f".{path.name}.new")
    try:
        with new.open("wb") as file:
            if isinstance(content, str):
                file.write(content.encode())
            else:
                content(file)
            if sync:
                file.flush()
                os.fsync(file.fileno())
        os.replace(new, path)
    except OSError as error:
        remove(new)
        raise BadInput(f"cannot write {path}: {error.strerror or error}") from None


def check_whole(written: Path, path: Path, ending: bytes) -> None:
    """See that a library, which need not say so, could write a file that is to be ``path``.

    BadInput with the reason if it does not end with ``ending``, as on a full disk.
    """
    why = "it was cut short"
    try:
        if written.exists():
            with written.open("rb") as file:
                file.seek(0, os.SEEK_END)
                file.seek(max(0, file.tell() - len(ending) - 16))
                if file.read().rstrip().endswith(ending):
                    return
        with written.open("ab") as file:  # whatever stopped the library stops us
            file.write(b" " * 65536)
    except OSError as error:
        why = error.strerror or str(error)
    raise BadInput(f"cannot write {path}: {why}")


def remove(path: Path) -> None:
    """Remove a file if it is there and may be."""
    try:
        path.unlink(missing_ok=True)
    except OSError:
        pass  # a leftover does no harm
