"""Reading files, and replacing them as a whole: a reader finds the old content or the new one.

All output of runs and studies is written here. The new content is written to a file with a random
hidden name, which is created exclusively: it neither follows a link nor replaces another file.
"""

from __future__ import annotations

import hashlib
import os
import re
import secrets
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, BinaryIO, TypeGuard

from fem_snh.errors import BadInput, bad_value

if TYPE_CHECKING:
    from xml.etree import ElementTree as ET


def read_text(path: str | Path, encoding: str = "utf-8", errors: str = "strict") -> str:
    """Return the text of a file. Raises OSError and UnicodeDecodeError."""
    return Path(path).read_text(encoding=encoding, errors=errors)


def is_shape(path: object) -> TypeGuard[Path]:
    """Return whether a path names an exact shape, which has to be meshed: an .xao file."""
    return isinstance(path, Path) and path.suffix.lower() == ".xao"


def xdmf_root(path: str | Path) -> ET.Element:
    """Return the root element of an XDMF file. Raises OSError, and ValueError for another file."""
    from xml.etree import ElementTree as ET  # few commands read one

    try:
        root = ET.fromstring(read_text(path))
    except ET.ParseError as error:
        raise ValueError(str(error)) from None
    if root.tag != "Xdmf":
        raise ValueError(f"its root is {root.tag}")
    return root


def xdmf_data(path: str | Path) -> list[Path]:
    """Return the HDF5 files of a .xdmf file, sorted; [] for another or an unreadable file."""
    if Path(path).suffix.lower() != ".xdmf":
        return []
    try:
        items = [item for item in xdmf_root(path).iter("DataItem") if item.get("Format") == "HDF"]
    except (OSError, ValueError):
        return []
    names = {(item.text or "").strip().partition(":")[0] for item in items}
    return [Path(path).parent / name for name in sorted(names)]


def file_digest(path: str | Path) -> str:
    """Return a short hash of a file's content, 16 digits of its SHA-256. Raises OSError."""
    state = os.stat(path)
    return _digest(os.path.abspath(path), state.st_mtime_ns, state.st_size)


@lru_cache
def _digest(path: str, _modified: int, _size: int) -> str:
    """Return `file_digest`; time and size are cache keys, so a changed file is hashed again."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()[:16]


def output_path(key: str, path: str | Path) -> Path:
    """Return ``path`` as a Path, the value of ``key`` that a user gave for output.

    Raises
    ------
    BadInput
        For an empty text, which would be the working directory, and for a null byte.
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


def remove_leftovers(folder: Path, is_own: Callable[[str], bool]) -> None:
    """Remove temporary files of killed processes, if ``is_own`` accepts the final file's name."""
    for path in folder.iterdir():
        match = re.fullmatch(r"\.(.+)\.[0-9a-f]{16}\.new", path.name)
        if match and is_own(match[1]):
            remove(path)


@contextmanager
def replacement(path: Path) -> Iterator[Path]:
    """Provide a path of the same name in a temporary folder; at the end move the file to ``path``.

    It is for libraries that write to a path; see `replace_file`. Raises BadInput if that fails.
    """
    try:
        with TemporaryDirectory(dir=path.parent, prefix=".") as folder:
            new = Path(folder) / path.name
            yield new
            os.replace(new, path)
    except OSError as error:
        raise BadInput(f"cannot write {path}: {error.strerror or error}") from None


def write_file(path: str | Path, content: str | Callable[[BinaryIO], object]) -> Path:
    """Write a file as `replace_file` does, and create its folder; return its path."""
    path = Path(path)
    make_folder_of(path)
    replace_file(path, content)
    return path


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
        A text, or a function that writes to the binary file it is given, which is also readable.
    sync : bool
        Whether to wait until the content is on the disk, so that it survives a loss of power.

    Raises
    ------
    BadInput
        If the file cannot be written, as on a full disk; an earlier file is unchanged.
    """
    new = path.with_name(f".{path.name}.{secrets.token_hex(8)}.new")
    try:
        with new.open("x+b") as file:
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


def remove(path: Path) -> None:
    """Remove a file if it exists; ignore errors."""
    with suppress(OSError):  # a remaining file does no harm
        path.unlink(missing_ok=True)
