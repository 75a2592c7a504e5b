"""The README fits a screen and its example runs; the how-to pages' material and scene are found."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from pages import for_this_dolfinx
from paths import ROOT

import fem_snh
from fem_snh import materials, scenes
from fem_snh.materials import models
from fem_snh.scenes import builtin

pytestmark = pytest.mark.one_debian

README = (ROOT / "README.md").read_text()


def block(kind: str, containing: str, page: str = "README.md") -> str:
    """Return the fenced block of this kind that contains a text."""
    text = (ROOT / page).read_text()
    (found,) = (b for b in re.findall(rf"```{kind}\n(.*?)```", text, re.S) if containing in b)
    return str(found)


def test_fits_a_screen() -> None:
    assert len(README.splitlines()) <= 60
    assert len(re.findall(r"^\| (?!scene|---)", README, re.M)) <= 8
    for link in re.findall(r"\]\(([^):]+)\)", README):
        assert (ROOT / link).exists(), link


def test_example(capsys: pytest.CaptureFixture[str]) -> None:
    """The program of the README runs; on dolfinx 0.5 with the line that its comment names."""
    code = block("python", "import fem_snh")
    lines = [line for line in code.splitlines() if line and not re.match("#|import|from", line)]
    assert len(lines) <= 10
    exec(for_this_dolfinx(code), {})
    converged, newton = capsys.readouterr().out.split()
    assert converged == "True" and int(newton) <= 20


def test_new_material(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "gel.py").write_text(block("python", "def gel", "docs/howto/own_material.md"))
    monkeypatch.setattr(models, "__path__", [*models.__path__, str(tmp_path)])
    monkeypatch.delitem(sys.modules, f"{models.__name__}.gel", raising=False)  # of another test
    assert "gel" in fem_snh.materials()
    m = fem_snh.material("gel", E=2.0, nu=0.3)
    assert m.lame == pytest.approx(materials.make_energy("neo_hookean", 2.0, 0.3).lame)
    assert m.energy(np.diag([6.0, 1.0, 1.0])) == np.inf
    result = fem_snh.run("twist", material="gel", cells=2, steps=4, progress=False)
    assert result.converged


def test_new_scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "squeeze.py").write_text(block("python", "def squeeze", "docs/howto/own_scene.md"))
    monkeypatch.setattr(builtin, "__path__", [*builtin.__path__, str(tmp_path)])
    assert "squeeze" in scenes.names()
    result = fem_snh.run("squeeze", cells=2, depth=0.2, progress=False)
    assert result.converged and result.steps[-1]["volume_ratio"] < 1
