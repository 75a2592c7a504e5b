"""Functions outside the package: ``FILE.py:NAME`` and entry points, and their mistakes."""

from __future__ import annotations

import os
from importlib import metadata
from pathlib import Path

import pytest

from fem_snh import references
from fem_snh.errors import BadInput
from fem_snh.references import FileText, entry_points, load_reference

pytestmark = pytest.mark.one_debian

FILE = """
import math
from neighbour import FACTOR
SIZE = 3
def press(cells=2):
    return FACTOR * cells
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "press.py").write_text(FILE)
    (tmp_path / "neighbour.py").write_text("FACTOR = 10\n")
    return tmp_path


def test_a_function_of_a_file_is_found(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert load_reference(FileText("press.py:press", folder))(4) == 40
    assert load_reference(f"{folder}/press.py:press")(1) == 10
    monkeypatch.chdir(folder)
    press = load_reference("press.py:press")
    assert press is load_reference(f"{folder}/press.py:press")


def test_a_file_is_executed_again_when_it_has_changed(folder: Path) -> None:
    path = folder / "press.py"
    before = load_reference(FileText("press.py:press", folder))
    path.write_text(FILE.replace("FACTOR * cells", "cells"))
    os.utime(path, ns=(0, 0))
    after = load_reference(FileText("press.py:press", folder))
    assert (before(4), after(4)) == (40, 4)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\ndef press(:\n", r"bad.py does not import: line 2: SyntaxError: .+"),
        ("import nowhere_at_all\n",
         "line 1: ModuleNotFoundError: No module named 'nowhere_at_all'"),
        ("\n\n1 / 0\n", "line 3: ZeroDivisionError: division by zero"),
        ("def f():\n    raise ValueError('a\\nb')\nf()\n", "line 2: ValueError: a b$"),
        ("raise SystemExit(3)\n", "line 1: SystemExit: 3"),
    ],
)  # fmt: skip
def test_a_file_that_does_not_import(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "bad.py").write_text(text)
    with pytest.raises(BadInput, match=message) as caught:
        load_reference(FileText("bad.py:press", tmp_path))
    assert "\n" not in str(caught.value)


def test_entry_points(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        metadata.EntryPoint("join", "os.path:join", "fem_snh.scenes"),
        metadata.EntryPoint("absent", "nowhere_at_all:f", "fem_snh.scenes"),
        metadata.EntryPoint("data", "os:sep", "fem_snh.scenes"),
    ]
    monkeypatch.setattr(references.metadata, "entry_points", lambda group: points)
    entry_points.cache_clear()
    found = entry_points("fem_snh.scenes")
    assert list(found) == ["absent", "data", "join"] and found["join"]() is os.path.join
    with pytest.raises(BadInput, match=r"fem_snh.scenes: absent = nowhere_at_all:f: ModuleNot"):
        found["absent"]()
    with pytest.raises(BadInput, match="data = os:sep: it is of type str: expected a function"):
        found["data"]()
    monkeypatch.undo()
    entry_points.cache_clear()
