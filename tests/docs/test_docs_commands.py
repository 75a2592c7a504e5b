"""Every command of the pages is accepted by its program, and run as it is or quick.

Commands of blocks are run as they are (test_docs.py). What is long or in a text is run with
the options of `QUICK` after its own, the last of which count (quick_commands.py).
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
from quick_commands import BENCH, NOT_QUICK, QUICK

import benchmarks
from fem_snh import cli, scenes
from fem_snh.cli.options import assignments, split_petsc, value
from fem_snh.cli.run import SCENE_OPTIONS

pytestmark = pytest.mark.one_debian

_TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
_OPTION = re.compile(r'add_argument\(\s*"(--[\w-]+)"')
_PYTEST = re.compile(r'addoption\(\s*"(--[\w-]+)"')


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
        elif words[:3] == BENCH.split():
            if words[3] != "NAME":
                accept_benchmark(words[3:], command)
        elif words[0] == "make":
            assert all(word in _TARGETS for word in words[1:] if "=" not in word), command
            paths = (word.partition("=")[2] for word in words if word.startswith("PYTEST="))
            known = _PYTEST.findall((ROOT / "tests/conftest.py").read_text())
            assert all((ROOT / path).exists() or path in known for path in paths), command
        elif words[0] == "python" and words[1].endswith(".py"):
            known = set(_OPTION.findall((ROOT / words[1]).read_text()))
            assert {word for word in words[2:] if word.startswith("--")} <= known, command


def accept(name: str, words: list[str], parser: Any) -> None:
    """Parse the options of a command as the program does; load the scene that it names."""
    words, petsc = split_petsc(words)
    args = parser.parse(words)
    files = [word for word in words if re.search(r"\.(py|toml|csv)\b", word)]  # of the page
    if name == "run" and args.scene in scenes.names() and not files:
        values = {key: getattr(args, key) for key in SCENE_OPTIONS}
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
        key = max((key for key in QUICK if text.startswith(key)), key=len, default=None)
        if key is None or text.startswith(NOT_QUICK):
            continue
        if words[0] == "python":
            options = benchmark_options(words[3:]) | benchmark_options(["", *QUICK[key].split()])
            words = [*words[:4], *(w for k, v in sorted(options.items()) for w in (f"--{k}", v))]
        else:
            quick = QUICK[key].split()
            for option in quick[::2]:  # its first value does not count
                while option.startswith("--") and option in words:
                    del words[(at := words.index(option)) : at + 2]
            at = words.index("--") if "--" in words else len(words)
            words[at:at] = quick
        found[shlex.join(words)] = None
    return list(found)


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
        assert "no solver has the PETSc option" not in printed.out  # a misspelt one
        return
    options = {key: value(text) for key, text in benchmark_options(words[3:]).items()}
    code = benchmarks.main(words[3], options)
    assert code in (0, 1)  # the limits are of the whole measurement
    printed = capsys.readouterr().out.splitlines()
    assert printed and all(json.loads(line)["bench"] == words[3] for line in printed)
