"""The commands: output and exit codes of what works."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import start_program

from fem_snh import cli, materials, scenes

TINY = ["run", "twist", "--cells", "2", "--set", "angle=0.2", "--steps", "1", "--quiet"]


def test_help(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main([]) == 0
    short = capsys.readouterr().out
    assert all(command in short for command in cli.COMMANDS)
    assert cli.main(["run"]) == 0
    listed = capsys.readouterr().out
    assert all(scenes.describe(name) in listed for name in scenes.names())
    assert cli.main(["--version"]) == 0


def test_a_material_is_measured(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.chdir(tmp_path)
    words = "materials neo_hookean --nu 0.3 --set material.alpha=1.5 --report --plot"
    assert cli.main(words.split()) == 0
    output = capsys.readouterr().out
    assert "nu = 0.3, alpha = 1.5" in output and "infinite for J <= 0" in output
    assert output.endswith("neo_hookean.png\n") and Path("neo_hookean.png").stat().st_size > 10_000


def test_materials_are_compared(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    some = ["neo_hookean", "stable_neo_hookean"]
    monkeypatch.setattr(materials, "names", lambda: some)
    assert cli.main(["materials", "--table", "--nu=0.3", "--csv", str(tmp_path / "a.csv")]) == 0
    output = capsys.readouterr()
    assert all(name in output.out for name in some) and not output.err
    rows = (tmp_path / "a.csv").read_text().splitlines()
    assert len(rows) == 3 and rows[0].startswith("name,nu,mu_lame,lambda_lame,inversion,")


@pytest.mark.one_debian
@pytest.mark.parametrize("ranks", [1, 2])
def test_run(ranks: int, tmp_path: Path) -> None:
    done = start_program(*TINY, "--nu=0.3", "--out", str(tmp_path / "a"), ranks=ranks)
    assert done.returncode == 0, done.stderr
    record = json.loads((tmp_path / "a" / "run.json").read_text())
    assert record["converged"] and record["ranks"] == ranks
    assert record["material"]["nu"] == 0.3 and len(record["steps"]) == 1


def test_petsc_options_reach_the_solver_and_no_convergence_is_1(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = start_program(*TINY, "--out", str(out), "--", "-snes_max_it", "0")
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert json.loads((out / "run.json").read_text())["converged"] is False


def test_a_closed_pipe_is_no_error() -> None:
    command = f"{sys.executable} -m fem_snh materials | head -1"
    done = subprocess.run(["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True)
    assert done.returncode in (0, 128 + signal.SIGPIPE) and "Traceback" not in done.stderr
