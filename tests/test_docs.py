"""The pages are of this program: their code runs, their commands, options and names exist."""

from __future__ import annotations

import argparse
import inspect
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest
from pages import PAGES, ROOT, SHELL, Block, blocks, commands, words_of

import benchmarks
import fem_snh
from fem_snh import cli, scenes

#: Commands that pages name and this repository does not have.
OTHERS = {"apt-get", "cd", "export", "git", "paraview", "pip", "sudo", "source", "tail"}
_TARGETS = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.M))
_INLINE = re.compile(r"(?<!`)`((?:fem-snh|python -m benchmarks|mpirun|make) [^`\n]+)`(?!`)")


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def runnable(page: Path) -> bool:
    """Whether a page has a block to run. Measurements, on the results pages, take too long."""
    found = [block for block in blocks(page) if "not run" not in block.note]
    return "results" not in page.parts and any(b.kind in ("python", "toml", *SHELL) for b in found)


@pytest.mark.parametrize("page", [page for page in PAGES if runnable(page)], ids=name_of)
def test_page_runs(page: Path, tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(Path(__file__).parent / "pages.py"), str(page)],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        timeout=300,
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_commands_exist(page: Path) -> None:
    shell = (block for block in blocks(page) if block.kind in SHELL)
    found = [command for block in shell for command, _ in commands(block)]
    found += _INLINE.findall(page.read_text(encoding="utf-8"))
    parsers = cli.parsers()
    for command in found:
        check(words_of(command), parsers, command)


def check(words: list[str], parsers: dict[str, argparse.ArgumentParser], command: str) -> None:
    """Assert that a command's program, its sub-command, its options and its names exist."""
    if not words:
        return
    if words[0] == "fem-snh":
        check_fem_snh(words[1:], parsers, command)
    elif words[:3] == ["python", "-m", "benchmarks"]:
        check_benchmark(words[3:], command)
    elif words[0] == "make":
        assert all(word in _TARGETS for word in words[1:] if "=" not in word), command
    elif words[0] == "python":
        script = next((word for word in words[1:] if word.endswith(".py")), None)
        assert script is None or "/" not in script or (ROOT / script).exists(), command
    else:
        known = words[0] in OTHERS or (ROOT / words[0]).exists()
        assert known, command


def check_fem_snh(
    words: list[str], parsers: dict[str, argparse.ArgumentParser], command: str
) -> None:
    if not words or words[0].isupper() or words[0].startswith("--"):
        return  # a placeholder, or the program's own options
    assert words[0] in parsers, command
    own = words[1 : words.index("--")] if "--" in words else words[1:]
    options = parsers[words[0]]._option_string_actions
    for before, word in zip(["", *own], own, strict=False):
        if word.startswith("--"):
            assert word.partition("=")[0] in options, f"{command}: {word}"
        elif before == "--material" and not re.search(r"[^a-z_,0-9]", word):
            assert set(word.split(",")) <= set(fem_snh.materials()), f"{command}: {word}"
    first = own[0] if own else ""
    if words[0] in ("run", "sweep", "tradeoff") and re.fullmatch(r"[a-z_]+", first):
        assert first in scenes.names(), command
    if words[0] == "materials" and re.fullmatch(r"[a-z_]+", first):
        assert first in fem_snh.materials(), command


def check_benchmark(words: list[str], command: str) -> None:
    if not words or words[0].isupper():
        return
    assert words[0] in benchmarks.NAMES, command
    rows = import_module(f"benchmarks.{words[0]}").rows
    known = inspect.signature(rows).parameters
    for word in words[1:]:
        if word.startswith("--"):
            assert word[2:] in known, f"{command}: {word}"


def test_pages_cite_what_exists() -> None:
    """Files of the repository that pages name in backticks."""
    pattern = re.compile(r"`((?:fem_snh|benchmarks|demos|docs|meshes|tests|tools)/[\w./]+)`")
    for page in PAGES:
        for path in pattern.findall(page.read_text(encoding="utf-8")):
            exists = "NAME" in path or (ROOT / path).exists()
            assert exists, f"{name_of(page)}: {path}"


def test_run_json_page_has_every_key(tmp_path: Path) -> None:
    """The tables of docs/reference/run_json.md are the keys of a run.json."""
    text = (ROOT / "docs/reference/run_json.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `(\w+)`", text, re.M))
    record = fem_snh.run("twist", cells=2, modes={"count": 1}, progress=False).record
    found = {*record, *record["steps"][0], *record["seconds"], *record["modes"]}
    assert found <= listed
    assert listed - found <= {"accuracy", "resumed"}


def test_blocks_of_a_page(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "a\n\n<!-- not run -->\n```console\n$ fem-snh run twist \\\n  --quiet\nx\n```\n"
    )
    (block,) = blocks(page)
    assert block == Block(4, "console", "$ fem-snh run twist \\\n  --quiet\nx\n", "not run")
    assert list(commands(block)) == [("fem-snh run twist    --quiet", "x\n")]
    assert words_of("mpirun -n 2 .venv/bin/fem-snh run twist  # on two") == [
        "fem-snh", "run", "twist",
    ]  # fmt: skip
