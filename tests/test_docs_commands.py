"""Every command of the pages is accepted by its program, and run: as it is, quick, or elsewhere.

Commands of blocks are run as they are (test_docs.py). What is long or in a text is run with
the options of `QUICK` after its own, the last of which count, or by the file of `ELSEWHERE`.
"""

from __future__ import annotations

import inspect
import json
import re
import shlex
import shutil
from importlib import import_module
from pathlib import Path
from typing import Any

import pytest
from pages import (
    DEMOS,
    PAGES,
    ROOT,
    SHELL,
    blocks,
    commands,
    measured,
    name_of,
    page_commands,
    words_of,
)

import benchmarks
from fem_snh import cli, scenes
from fem_snh.cli.options import SCENE_OPTIONS, assignments, split_petsc, value

_BENCH = "python -m benchmarks"
#: Beginning of a command -> options that make it quick. The longest beginning counts.
QUICK = {
    "fem-snh materials": "",
    "fem-snh materials --table": "stable_neo_hookean",
    "fem-snh run": "--cells 3 --steps 1",
    "fem-snh run squash": "--cells 8 --steps 1",
    "fem-snh run twist --element P2P1": "--element Q1 --cells 2 --steps 1",
    f"{_BENCH} assembly": "--elements Q1 --material stable_neo_hookean --cells 2 --repeat 1",
    f"{_BENCH} contact_patch": "--elements Q1 --upper 2 --stiffness 1 --methods penalty",
    f"{_BENCH} cell_pressures": "--elements P2P0 --scenes block --nus 0.49 --cells 4",
    f"{_BENCH} convergence_orders": "--elements Q1 --nus 0.3 --cells 1,2",
    f"{_BENCH} bounce": "--integrators bdf2 --cells 2 --steps 5",
    f"{_BENCH} coo_assembly": "--elements Q1 --cells 2 --repeat 1",
    f"{_BENCH} dolfinx_program": "--parts scene --scene_cells 3 --repeat 1",
    f"{_BENCH} eigensolvers": "--samples 1 --points 16",
    f"{_BENCH} bones": "--scene torso --cells 30 --steps 2",
    f"{_BENCH} elbow": "--cells 12 --nus 0.3 --angles 90 --cells_of_biceps 0",
    f"{_BENCH} fields": "--elements Q1 --cells 2 --fields von_mises --repeat 1",
    f"{_BENCH} hessian_filters": "--elements Q1 --nus 0.3 --cells 1 --seeds 1",
    f"{_BENCH} hertz": "--depths 0.2 --cells 2",
    f"{_BENCH} interface": "--elements Q1P0 --cells 2",
    f"{_BENCH} linear_iterations": "--cells 3 --nus 0.49 --solvers cg+ssor",
    f"{_BENCH} linear_solvers": "--bodies layer --elements Q1 --nus 0.4999 --cells 16",
    f"{_BENCH} memory_traffic": "--cells 3 --repeat 1",
    f"{_BENCH} mixed_times": "--sizes 2000 --elements P2P1",
    f"{_BENCH} negative_curvature": "--nus 0.3 --cells 3 --seeds 1 --lbfgs 0,20",
    f"{_BENCH} petsc_newton": "--cells 3 --nus 0.3 --methods ours,bntr,bntr+icc",
    f"{_BENCH} petsc_parts": "--scenes twist --cells 2 --steps 1 --repeat 1",
    f"{_BENCH} plates": "--elements Q1 --integrators semi_implicit --cells 2 --steps 2",
    f"{_BENCH} quadrature": "--elements Q1 --nus 0.3 --cells 1 --repeat 1",
    f"{_BENCH} references": "--only uniaxial",
    f"{_BENCH} regions": "--elements Q1 --counts 2 --cells 2 --repeat 1",
    f"{_BENCH} start": "--repeat 1",
    f"{_BENCH} sweep": "--points 6 --cells 2",
    f"{_BENCH} squash": "--cells 20 --frames 1",
    f"{_BENCH} stretch_times": "--cells 3 --ways ours --steps 1 --ranks 1 --timeout 60",
    f"{_BENCH} taylor_hood": "--elements Q2Q1 --scenes stretch --nus 0.3 --cells 4",
    f"{_BENCH} twist": "--cells 2",
    f"{_BENCH} ufl_filter": "--elements Q1 --cells 2 --amplitude 0.02 --repeat 1",
    f"{_BENCH} volume_split": "--elements Q1 --bounds 1 --stretches 1 --cells 1",
}
#: Beginning of a command -> the test that runs it, or for a script the file that does.
ELSEWHERE = {
    ".ci/in-root": ".ci/run",
    ".ci/run": ".ci/run",
    "export": "Makefile",
    "fem-snh doctor": "tests/test_doctor.py",
    "fem-snh extremes": "tests/test_extremes.py",
    "fem-snh plot": "tests/test_plots.py",
    "fem-snh render": "tests/test_render.py",
    "fem-snh run cook --accuracy": "docs/howto/choose.md",
    "fem-snh run out/own_mesh/bracket.toml": "tests/test_demos.py",
    "fem-snh run own.toml": "tests/test_tradeoff.py",
    "fem-snh run pull --material demos/gent.py:gent": "docs/howto/own_material.md",
    "fem-snh materials demos/gent.py:gent": "docs/howto/own_material.md",
    "fem-snh run squeeze.toml": "docs/howto/own_scene.md",
    "fem-snh run stretch --out out/stretch --resume": "tests/test_resume.py",
    "fem-snh sweep": "tests/test_sweep.py",
    "fem-snh tradeoff": "tests/test_tradeoff.py",
    "make": "Makefile",
    "python -c": "tests/test_pointwise_extremes.py",
    "python demos/": "tests/test_demos.py",
    f"{_BENCH} extremes_page": "tests/test_docs_commands.py",
    f"{_BENCH} faults": "tests/test_faults.py",
    f"{_BENCH} felupe_twist": "tests/test_bench.py",
    f"{_BENCH} ranks": "tests/test_ranks.py",
    f"{_BENCH} tradeoff_tables": "tests/test_docs_commands.py",
    "source": "tools/setup",
}
_TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
_OPTION = re.compile(r'add_argument\(\s*"(--[\w-]+)"')


def longest(table: dict[str, str], command: str) -> str | None:
    """Return the longest key of a table with which a command begins."""
    return max((key for key in table if command.startswith(key)), key=len, default=None)


def placeholder(words: list[str]) -> bool:
    """Whether a command stands for several: `fem-snh COMMAND ...`, or a bare `fem-snh run`."""
    return len(words) < 3 or any(re.fullmatch(r"[A-Z]{2,}|\.\.\.", word) for word in words)


@pytest.mark.parametrize("page", [*PAGES, *DEMOS], ids=name_of)
def test_commands_are_accepted(page: Path) -> None:
    parsers = cli.parsers()
    for command in page_commands(page):
        words = words_of(command)
        if not words:
            continue
        if words[0] == "fem-snh":
            name = next((word for word in words[1:] if not word.startswith("--")), "run")
            assert name in parsers or name.isupper(), command
            if not placeholder(words):
                accept(name, words[2:], parsers[name])
        elif words[:3] == _BENCH.split():
            if words[3] != "NAME":
                accept_benchmark(words[3:], command)
        elif words[0] == "make":
            assert all(word in _TARGETS for word in words[1:] if "=" not in word), command
            paths = (word.partition("=")[2] for word in words if word.startswith("PYTEST="))
            assert all((ROOT / path).exists() for path in paths), command
        elif words[0] == "python" and words[1].endswith(".py"):
            known = set(_OPTION.findall((ROOT / words[1]).read_text()))
            assert {word for word in words[2:] if word.startswith("--")} <= known, command
        else:
            assert longest(ELSEWHERE, " ".join(words)), command


def accept(name: str, words: list[str], parser: Any) -> None:
    """Parse the options of a command as the program does; load the scene that it names."""
    words, petsc = split_petsc(words)
    args = parser.parse(words)
    files = [word for word in words if re.search(r"\.(py|toml|csv)\b", word)]  # of the page
    if name in ("run", "tradeoff") and args.scene in scenes.names() and not files:
        keys = [key for key, _, _ in SCENE_OPTIONS if name == "run"]
        values = {key: getattr(args, key) for key in keys}
        values |= {key: value(word) for key, word in assignments(args.set).items()}
        scenes.load(args.scene, **values | ({"petsc": petsc} if petsc else {}))


def accept_benchmark(words: list[str], command: str) -> None:
    """Assert that a benchmark has the options, and that they take values of that type."""
    assert words[0] in benchmarks.NAMES, command
    known = inspect.signature(import_module(f"benchmarks.{words[0]}").rows).parameters
    for key, text in benchmark_options(words).items():
        kinds = {"int": int, "float": (int, float), "bool": bool}
        assert isinstance(value(text), kinds.get(known[key].annotation, object)), command


def benchmark_options(words: list[str]) -> dict[str, str]:
    """Return the options of a benchmark by name; of one that is repeated the last."""
    assert all(option.startswith("--") for option in words[1::2]) and len(words) % 2, words
    return {option[2:]: text for option, text in zip(words[1::2], words[2::2], strict=True)}


def quick_commands() -> list[str]:
    """Return the quick variants of all commands that no page runs as they are, each once."""
    here = {
        command
        for page in PAGES
        for block in blocks(page)
        if block.kind in SHELL and not measured(page, block)
        for command, _ in commands(block)
    }
    found = {}
    for command in (c for page in [*PAGES, *DEMOS] for c in page_commands(page)):
        words = words_of(command)
        if command in here or not words or (placeholder(words) and words[0] == "fem-snh"):
            continue
        text = shlex.join(words)
        key, other = longest(QUICK, text), longest(ELSEWHERE, text)
        if key is None or len(other or "") > len(key):
            continue
        if words[0] == "python":
            options = benchmark_options(words[3:]) | benchmark_options(["", *QUICK[key].split()])
            words = [*words[:4], *(w for k, v in sorted(options.items()) for w in (f"--{k}", v))]
        else:
            at = words.index("--") if "--" in words else len(words)
            words[at:at] = QUICK[key].split()
        found[shlex.join(words)] = None
    return list(found)


def test_every_command_is_run_somewhere() -> None:
    """As it is on a page that is run, quick, or by a test that exists."""
    for page in [*PAGES, *DEMOS]:
        for command in page_commands(page):
            text = " ".join(words := words_of(command))
            if words and not (words[0] == "fem-snh" and placeholder(words)) and "NAME" not in words:
                on_page = words[0] == "fem-snh" and "results" not in page.parts
                assert on_page or longest(QUICK | ELSEWHERE, text), f"{name_of(page)}: {command}"
    assert all((ROOT / path).exists() for path in ELSEWHERE.values())
    texts = [" ".join(words_of(c)) for page in [*PAGES, *DEMOS] for c in page_commands(page)]
    unused = [k for k in [*QUICK, *ELSEWHERE] if not any(text.startswith(k) for text in texts)]
    assert not unused


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a copy of the results pages, which some commands rewrite."""
    here = tmp_path_factory.mktemp("pages")
    shutil.copytree(ROOT / "docs" / "results", here / "docs" / "results")
    return here


@pytest.mark.parametrize("command", quick_commands(), ids=str)
def test_quick_variant_runs(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(folder)
    words = words_of(command)
    if words[0] == "fem-snh":
        if "--out" in words:
            shutil.rmtree(words[words.index("--out") + 1], ignore_errors=True)
        code = cli.main(words[1:])
        printed = capsys.readouterr()
        assert code == 0, printed
        assert "nothing used the PETSc option" not in printed.out  # a misspelt one
        return
    options = {key: value(text) for key, text in benchmark_options(words[3:]).items()}
    code = benchmarks.main(words[3], options)
    assert code in (0, 1)  # the limits are of the whole measurement
    printed = capsys.readouterr().out.splitlines()
    assert printed and all(json.loads(line)["bench"] == words[3] for line in printed)


@pytest.mark.parametrize("page", ["tradeoff.md", "tradeoff_tables.md", "extremes_tables.md"])
def test_tables_are_those_of_the_data(page: str, folder: Path) -> None:
    """The tables of the pages are what the CSV files beside them give."""
    write = folder / "docs" / "results" / page
    name = "extremes_page" if "extremes" in page else "tradeoff_tables"
    assert list(import_module(f"benchmarks.{name}").rows(write=str(write)))
    assert write.read_text() == (ROOT / "docs" / "results" / page).read_text()
