"""``fem-snh compile``: runs with what it compiled compile nothing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from fem_snh.cli import main

#: Runs on other values of Poisson's ratio than those of `fem_snh.cli.compile`: below 0.4, where
#: stable_neo_hookean has another energy, and near 0.5, with pressures of the cells as unknowns.
RUNS = (
    "twist --cells 3 --element P1 --nu 0.35",
    "twist --cells 3 --element P1 --nu 0.45 --material stvk",
    "twist --cells 2 --element P2P0 --nu 0.4998",
)


def test_runs_after_it_compile_nothing(tmp_path: Path) -> None:
    # XDG_CACHE_HOME has what FFCx compiles for dolfinx.
    caches = {"FEM_SNH_CACHE": str(tmp_path / "own"), "XDG_CACHE_HOME": str(tmp_path / "dolfinx")}

    def compiled_by(*arguments: str) -> set[Path]:
        before = {*tmp_path.rglob("*.o"), *tmp_path.rglob("*.so")}
        command = [sys.executable, "-m", "fem_snh", *arguments]
        done = subprocess.run(command, env=os.environ | caches, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        return {*tmp_path.rglob("*.o"), *tmp_path.rglob("*.so")} - before

    # stvk has no volume term, which P2P0 needs: that is no error.
    made = compiled_by("compile", "stable_neo_hookean", "stvk", "--elements", "P1,P2P0")
    assert any(path.is_relative_to(caches["FEM_SNH_CACHE"]) for path in made)
    assert any(path.is_relative_to(caches["XDG_CACHE_HOME"]) for path in made)
    for run in RUNS:
        assert compiled_by("run", *run.split(), "--steps", "1") == set(), run


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ("stable_neo_hokean", "did you mean 'stable_neo_hookean'?"),
        ("--elements P1,P3", "element = 'P3': expected one of P1,"),
    ],
)
def test_unknown_names_are_refused(
    arguments: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["compile", *arguments.split()]) == 2
    assert message in capsys.readouterr().err
