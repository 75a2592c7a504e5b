"""The user's cache folder, and small records in it: results that are the same in every run.

A record's key is a hash of all that its content depends on, source files of the package included,
so that no record is ever out of date. Records may be deleted at any time.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Iterable
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Any

import platformdirs

#: Hexadecimal digits of the hash in a file name: 96 bits, so that two keys never share a name.
KEY_DIGITS = 24


def folder() -> Path:
    """Return ``$FEM_SNH_CACHE``, or ``fem_snh`` in the user's cache folder (XDG_CACHE_HOME)."""
    if own := os.environ.get("FEM_SNH_CACHE"):
        return Path(own)
    return Path(platformdirs.user_cache_path("fem_snh", appauthor=False))


def key(*content: Any) -> str:
    """Return a key that identifies content: numbers, texts, sequences and mappings of them.

    Raises
    ------
    TypeError
        If the content has no representation in JSON.
    """
    text = json.dumps(content, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:KEY_DIGITS]


@lru_cache
def sources(*folders: str) -> str:
    """Return a hash of the source files in some folders of this package, e.g. "materials"."""
    found = hashlib.sha256()
    for path in _files(folders):
        found.update(path.name.encode() + b"\0" + path.read_bytes())
    return found.hexdigest()


def _files(folders: Iterable[str]) -> list[Path]:
    root = Path(__file__).parent
    return sorted(
        path
        for folder in folders
        for path in (root / folder).rglob("*")
        if path.suffix in (".py", ".h")
    )


def read(key: str) -> dict[str, Any] | None:
    """Return the record of a key, or None if there is none, or none that can be read."""
    try:
        record = json.loads((folder() / f"{key}.json").read_text())
    except (OSError, ValueError):
        return None
    return record if isinstance(record, dict) else None


def write(key: str, record: dict[str, Any]) -> None:
    """Store the record of a key. Other processes see all of it or nothing.

    A folder that cannot be written is no error: the record is computed again by the next run.
    """
    target = folder() / f"{key}.json"
    with suppress(OSError):
        target.parent.mkdir(parents=True, exist_ok=True)
        descriptor, name = tempfile.mkstemp(dir=target.parent, suffix=".new")
        with os.fdopen(descriptor, "w") as file:
            json.dump(record, file)
        os.replace(name, target)
