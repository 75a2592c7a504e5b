"""Mistakes on the command line: exit code 2 and one line, on every number of ranks."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import start_program

from fem_snh import cli
from fem_snh.studies.tasks import environment, program

MISTAKES = [
    ("runn", "command = 'runn': expected .*did you mean 'run'"),
    ("run twst", "scene = 'twst': expected .*did you mean 'twist'"),
    ("run --nu 0.3", "missing SCENE: expected .*twist"),
    ("run twist stretch", "unexpected 'stretch'"),
    ("sweep twist --out x --kinematics layer", "unknown option .--kinematics.: expected --set kin"),
    ("run twist --nuu 0.3", "unknown option '--nuu': expected .*--cells.*did you mean '--nu'"),
    ("run twist --nu", "--nu: expected one argument"),
    ("run twist --nu 0.51", r"material.nu = 0.51: expected a number in \(-1, 0.5\]"),
    ("run twist --nu 0.5", r"nu = 0.5: .* requires a Taylor-Hood element \(P2P1, Q2Q1\)"),
    ("run twist --nu -inf", "material.nu = -inf: "),
    ("run twist --nu abc", "material.nu = 'abc': "),
    ("run twist --set angle", "--set angle: expected key=value"),
    ("run twist --set angel=1", "unknown parameter 'angel': expected .*did you mean 'angle'"),
    ("run twist -- 1e-6", "'1e-6' after --: expected PETSc options"),
    ("run nothing.toml", "cannot read the scene nothing.toml"),
    ("run twist --nu 0.3 --set material.nu=0.4", "nu and material.nu: expected one of them"),
    ("run twist --set material={nu=0.3} --nu 0.4", "nu and material: expected one of them"),
    ("sweep twist", "required: --out"),
    ("sweep twist --out x --nu 0.3 --set material.nu=0.4", "nu and material.nu: expected one"),
    ("fit twist --to x --parameters E --nu 0.3 --set nu=0.4", "--nu and --set nu: expected one"),
    ("sweep twist --out x --nu 0.3,,0.4", "nu = '0.3,,0.4': expected values with commas"),
    ("sweep twist --out x --jobs 0", "jobs = 0: expected a whole number"),
    ("sweep twist --out x --timeout soon", "timeout = soon: expected seconds"),
    ("materials neohookean", "material = 'neohookean': expected .*did you mean 'neo_hookean'"),
    ("materials --plot neo_hookean", "missing NAME: expected with --report, --plot"),
    ("materials neo_hookean --report --nu x", "nu = 'x': expected a number"),
    ("materials gent --report --nu 0.3 --set material.nu=0.4", "--nu and --set nu: expected one"),
    ("materials neo_hookean --report --set alhpa=2", "'alhpa' .did you mean 'alpha'"),
    ("materials neo_hookean --plot a.xyz", "a.xyz: cannot be written"),
    ("plot", "required: DIR"),
    ("plot nowhere", "nowhere: no run.json"),
    ("render nowhere --loads 0.5,x", "--loads 0.5,x: expected numbers"),
    ("render nowhere --modes 1.5", "--modes 1.5: expected mode numbers"),
    ("render nowhere --modes --loads 1", "--loads and --modes: expected one of the two"),
    ("doctor now", "unexpected 'now'"),
    ("sweep twist --error --set error=true --out a", "--error and --set error: expected one of"),
]


@pytest.mark.parametrize(("words", "message"), MISTAKES, ids=[words for words, _ in MISTAKES])
def test_mistake(
    words: str, message: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert cli.main(words.split()) == 2
    output = capsys.readouterr()
    assert re.fullmatch(f"fem-snh: error: .*{message}.*\n", output.err)
    assert not output.out and not list(tmp_path.iterdir())


BLOCK = """
mesh = "block.msh"
element = "Q1"
[material]
name = "stable_neo_hookean"
E = 1
nu = 0.4
"""


FILES = [
    ("run block.toml", r"block\.msh"),
    ("run broken.toml", r"broken\.toml is not valid TOML.*line 2"),
    ("run twist --cells 2 --set hold.0.group=botom", "no physical group 'botom'.*'bottom'"),
    ("run twist --cells 2 --out file/folder", "output folder file/folder cannot be written"),
    ("run twist --cells 2 --out full", "full already holds a run.*--overwrite"),
]


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a scene whose mesh is missing, one that is broken, and so on."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "block.toml").write_text(BLOCK)
    (tmp_path / "broken.toml").write_text("steps = 1\nsteps = = 2\n")
    (tmp_path / "file").touch()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "run.json").write_text("{}")
    return tmp_path


@pytest.mark.parametrize(("words", "message"), FILES)
def test_mistake_in_files(
    words: str, message: str, capsys: pytest.CaptureFixture[str], here: Path
) -> None:
    assert cli.main(words.split()) == 2
    assert re.fullmatch(f"fem-snh: error: .*{message}.*\n", capsys.readouterr().err)
    assert (here / "full" / "run.json").read_text() == "{}"


@pytest.mark.parametrize(
    ("words", "message"), [*FILES[::2], *MISTAKES[:1], ("plot x", "x: no run")]
)
def test_mistake_on_two_ranks(words: str, message: str, here: Path) -> None:
    done = start_program(*words.split(), ranks=2)
    lines = [line for line in done.stderr.splitlines() if line.startswith("fem-snh: error: ")]
    assert done.returncode == 2 and len(lines) == 1, done.stderr
    assert re.search(message, lines[0]) and "Traceback" not in done.stderr


@pytest.mark.one_debian
def test_mistake_on_one_rank_only_ends_all(tmp_path: Path) -> None:
    script = tmp_path / "lone.py"
    script.write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from fem_snh import cli\n"
        "from fem_snh.errors import BadInput\n"
        "def dispatch(argv):\n"
        "    if MPI.COMM_WORLD.rank == 1:\n"
        "        raise BadInput('only here')\n"
        "    MPI.COMM_WORLD.Barrier()\n"
        "cli._dispatch, cli._BARRIER_TIMEOUT = dispatch, 0.5\n"
        "sys.exit(cli.main([]))\n"
    )
    mpirun = program(2)[:3]
    done = subprocess.run(
        [*mpirun, sys.executable, str(script)],
        env=environment(), capture_output=True, text=True, timeout=60,
    )  # fmt: skip
    assert done.returncode == 2 and done.stderr.count("fem-snh: error: only here") == 1


def test_missing_package_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "pydantic.py").write_text("raise ImportError('no pydantic here')")
    done = subprocess.run(
        [sys.executable, "-m", "fem_snh", "run", "twist"],
        env=environment() | {"PYTHONPATH": str(tmp_path)}, capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 2 and done.stderr.count("\n") == 1
    assert "no pydantic here" in done.stderr and "fem-snh doctor" in done.stderr


def test_names_of_any_length_and_any_letters_are_one_short_line(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    long = "n" * 3000
    monkeypatch.setenv("PYTHONIOENCODING", "latin-1:strict")
    for words in (["run", "twist", "--out", long], ["render", long], ["help", long]):
        done = start_program(*words)
        assert done.returncode == 2 and len(done.stderr.splitlines()) == 1
        assert len(done.stderr) < 700
    done = start_program("run", "twist", "--cells", "1", "--steps", "1", "--out", "\u4e2d")
    assert done.returncode == 0 and "\\u4e2d/run.json" in done.stdout
