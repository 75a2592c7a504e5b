"""Scenes outside the package: a function in a Python file, an entry point, a function itself."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import pytest

import fem_snh
from fem_snh import cli, references, scenes
from fem_snh.errors import BadInput
from fem_snh.references import entry_points

PRESS = '''
"""A cube pressed by a part of its height."""
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Scene

def press(cells: int = 2, depth: float = 0.1):
    """A cube of 1 m whose top is pressed down.

    Parameters
    ----------
    cells : int
        Cells along an edge.
    depth : float
        Displacement of the top [m].
    """
    return Scene(
        name="press",
        mesh=Geometry(source="cube"),
        cells=cells,
        element="Q1",
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
        hold=[Hold(group="bottom")],
        move=[Move(group="top", translate=(0, 0, -depth))],
    )

def plain(cells=2):
    return {"name": "plain"}

def wrong():
    return press(depth=float("nan"))

def fails(cells=2):
    raise RuntimeError("no such\\n body")

def needs(cells):
    return press(cells)

def own_mesh():
    return Scene(
        name="own_mesh", mesh="meshes/body.msh", element="P2",
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=0.3),
    )
'''


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, with the file."""
    (tmp_path / "press.py").write_text(PRESS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_a_function_of_a_file_is_a_scene(folder: Path) -> None:
    scene = scenes.load("press.py:press", cells=3, depth=0.2, nu=0.4)
    assert (scene.name, scene.cells, scene.material.nu) == ("press", 3, 0.4)
    assert scene.move[0].translate == (0, 0, -0.2)
    assert scenes.describe("press.py:press") == "A cube of 1 m whose top is pressed down."
    assert scenes.own_parameters("press.py:press") == {"cells": 2, "depth": 0.1}
    assert scenes.load(references.load_reference("press.py:press"), cells=3).cells == 3


@pytest.mark.parametrize(
    ("name", "overrides", "message"),
    [
        ("press", {"cells": 0}, "cells = 0: expected a whole number from 1 to 10000"),
        ("press", {"cells": "x"}, "cells = 'x': expected a whole number"),
        ("press", {"deep": 1}, r"unknown parameter 'deep': .*\(did you mean 'depth'\?\)"),
        ("plain", {}, "returned dict: expected a fem_snh.scenes.Scene"),
        ("wrong", {}, r"translate = \(0, 0, nan\): expected three finite numbers"),
        ("fails", {}, "line 32: RuntimeError: no such body"),
        ("needs", {}, "missing parameter 'cells': expected a value"),
        ("pres", {}, r"has no function 'pres' \(did you mean 'press'\?\)"),
    ],
)
def test_mistakes(folder: Path, name: str, overrides: dict[str, object], message: str) -> None:
    with pytest.raises(BadInput, match=message) as caught:
        scenes.load(f"press.py:{name}", **overrides)
    assert "\n" not in str(caught.value) and f"press.py:{name}" in str(caught.value)


@pytest.mark.one_debian
def test_it_runs(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    result = fem_snh.run("press.py:press", progress=False)
    assert result.converged and result.record["scene"] == "press"
    assert cli.main(["run", "press.py:press", "--set", "depth=0.2", "--quiet"]) == 0
    assert cli.main(["run", "press.py:plain"]) == 2
    assert capsys.readouterr().err.startswith("fem-snh: error: press.py:plain: returned dict")


def test_a_package_declares_scenes(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(folder)
    points = [
        metadata.EntryPoint("packed", "press:press", scenes.GROUP),
        metadata.EntryPoint("twist", "press:press", scenes.GROUP),
    ]
    monkeypatch.setattr(references.metadata, "entry_points", lambda group: points)
    entry_points.cache_clear()
    try:
        assert "packed" in scenes.names() and scenes.names().count("twist") == 1
        assert scenes.load("packed", cells=4).cells == 4
        assert scenes.load("twist").name == "twist"  # a package cannot replace a built-in scene
        with pytest.raises(BadInput, match=r"expected one of .*packed.*did you mean 'packed'"):
            scenes.load("paked")
    finally:
        monkeypatch.undo()
        entry_points.cache_clear()
