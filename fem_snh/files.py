"""Files that a user names: only regular ones are opened."""

from __future__ import annotations

import errno
import hashlib
import os
import stat
from functools import lru_cache
from io import BufferedReader
from pathlib import Path
from typing import TYPE_CHECKING, TypeGuard

if TYPE_CHECKING:
    from xml.etree import ElementTree as ET

_KINDS = {
    stat.S_IFIFO: "a FIFO",
    stat.S_IFCHR: "a character device",
    stat.S_IFBLK: "a block device",
    stat.S_IFSOCK: "a socket",
}


def check_regular(path: str | Path) -> None:
    """Raise OSError unless a path leads to a regular file, whose text is its ``strerror``.

    Opening a FIFO waits for a writer, and reading a device need not end.
    """
    mode = os.stat(path).st_mode
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "no file")
        raise OSError(errno.EINVAL, f"it is {kind}, expected a regular file", str(path))


def open_file(path: str | Path) -> BufferedReader:
    """Open a regular file to read bytes. Raises OSError, as `check_regular` and ``open`` do."""
    check_regular(path)
    return open(path, "rb")


def read_text(path: str | Path, encoding: str = "utf-8", errors: str = "strict") -> str:
    """Return the text of a regular file. Raises OSError and UnicodeDecodeError."""
    check_regular(path)
    return Path(path).read_text(encoding=encoding, errors=errors)


def is_shape(path: object) -> TypeGuard[Path]:
    """Return whether a path is that of an exact shape, for which cells are made: an .xao file."""
    return isinstance(path, Path) and path.suffix.lower() == ".xao"


def xdmf_root(path: str | Path) -> ET.Element:
    """Return the root of an XDMF file's text. Raises OSError, and ValueError for another file."""
    from xml.etree import ElementTree as ET  # few commands read one

    try:
        root = ET.fromstring(read_text(path))
    except ET.ParseError as error:
        raise ValueError(str(error)) from None
    if root.tag != "Xdmf":
        raise ValueError(f"its root is {root.tag}")
    return root


def xdmf_data(path: str | Path) -> list[Path]:
    """Return the HDF5 files that hold the numbers of a .xdmf file, none if it is unreadable."""
    if Path(path).suffix.lower() != ".xdmf":
        return []
    try:
        items = [item for item in xdmf_root(path).iter("DataItem") if item.get("Format") == "HDF"]
    except (OSError, ValueError):
        return []
    names = {(item.text or "").strip().partition(":")[0] for item in items}
    return [Path(path).parent / name for name in sorted(names)]


def file_digest(path: str | Path) -> str:
    """Return a short hash of a regular file's content, 16 digits of its SHA-256. Raises OSError."""
    state = os.stat(path)
    return _digest(os.path.abspath(path), state.st_mtime_ns, state.st_size)


@lru_cache
def _digest(path: str, _modified: int, _size: int) -> str:
    """Hash a file; time and size are part of the key, so that a changed file is hashed again."""
    with open_file(path) as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]
