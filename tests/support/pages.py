"""The blocks of code of the README and the documentation, and the runner of one page.

    python tests/support/pages.py PAGE.md          # in an empty folder

runs a page as its reader does, from top to bottom: Python blocks in one namespace, TOML blocks as
scenes, commands of `fem-snh` in the same process. A block whose first line is a comment with the
name of a file (`# gent.py`, `# squeeze.toml`, `// block.geo`) is that file. A comment above a block
is its note: `<!-- exit code 1 -->` is what its command returns; `<!-- quick: OLD => NEW -->`
replaces text of a Python block; the commands below `<!-- not run -->`, and those of the results
pages, are left to test_docs_commands.py, or `<!-- not run: FILE does -->` to that test. On dolfinx
0.5 a comment `# dolfinx 0.5: CODE` replaces the line before it.
"""

from __future__ import annotations

import functools
import io
import os
import re
import shlex
import shutil
import sys
import tomllib
from collections.abc import Iterator
from contextlib import redirect_stderr, redirect_stdout
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from markdown_it import MarkdownIt
from paths import ROOT

DEMOS = sorted((ROOT / "demos").glob("*.py"))
#: The pages of the gallery are written by `make docs` from the demos, which test_demos.py runs.
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "docs/gallery/index.md",
    *sorted(path for path in (ROOT / "docs").rglob("*.md") if path.parent.name != "gallery"),
]
SHELL = ("console", "bash", "sh")
_NOTE = re.compile(r"<!-- (.*) -->\n*")
_INLINE = re.compile(
    r"(?<!`)`((?:\.venv/bin/)?(?:fem-snh|python -m|python demos|mpirun|make) [^`\n]+)`(?!`)"
)
_FILE_NAME = re.compile(r"(?:#|//) (\S+\.(?:py|toml|geo|csv))\n")
_NUMBER = re.compile(r"[-+]?\d[\d,]*\.?\d*(e[-+]?\d+)?")
#: What a fragment of a scene file is completed with.
_SCENE: dict[str, Any] = {"mesh": {"source": "cube"}, "cells": 2, "element": "Q1"}
_MATERIAL = {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3}


def name_of(page: Path) -> str:
    """Return a page's path in the repository."""
    return str(page.relative_to(ROOT))


def demo_text(demo: Path) -> str:
    """Return the page of the gallery that is made from a demo."""
    sys.path.insert(0, str(ROOT / "docs" / "_ext"))
    try:
        from gallery import page
    finally:
        del sys.path[0]
    return page(demo)


class Block(NamedTuple):
    """A block of code: its line, its language, what it holds and the note above it.

    The language of a block that is indented instead of fenced is empty.
    """

    line: int
    kind: str
    text: str
    note: str

    @property
    def file_name(self) -> str | None:
        """The file's name that its first line gives, or None."""
        found = _FILE_NAME.match(self.text)
        return found[1] if found else None


def blocks(page: Path) -> tuple[Block, ...]:
    """Return the blocks of code of a page."""
    return blocks_of(page.read_text(encoding="utf-8"))


@functools.cache  # each page is read for its blocks, its commands and its test
def blocks_of(text: str) -> tuple[Block, ...]:
    """Return the blocks of code of a text in Markdown."""
    found, note = [], ""
    for token in MarkdownIt("commonmark").parse(text):
        if token.type in ("fence", "code_block"):
            assert token.map
            kind = token.info.split()[0] if token.info else ""
            found.append(Block(token.map[0] + 1, kind, token.content, note))
        match = _NOTE.fullmatch(token.content) if token.type == "html_block" else None
        note = match[1] if match else ""
    return tuple(found)


def measured(page: Path, block: Block) -> bool:
    """Whether a block's commands take too long to be run as they are."""
    return "results" in page.parts or "not run" in block.note


def runner(block: Block) -> str | None:
    """Return the file that runs a block's commands, if its note names one."""
    found = re.fullmatch(r"not run: (\S+) does", block.note)
    return found[1] if found else None


def page_commands(page: Path) -> list[str]:
    """Return every command of a page or a demo, of its blocks and in its text.

    Commands that a file runs which is named by the block's note are left to it.
    """
    text = demo_text(page) if page.suffix == ".py" else page.read_text(encoding="utf-8")
    shell = (block for block in blocks_of(text) if block.kind in SHELL)
    found = [command for block in shell if not runner(block) for command, _ in commands(block)]
    return found + _INLINE.findall(text)


def commands(block: Block) -> Iterator[tuple[str, str]]:
    """Yield each command of a shell block with the output that the page shows for it."""
    text = block.text.replace("\\\n", " ")
    if "$ " not in text:
        yield from ((line.strip(), "") for line in text.splitlines() if line.strip())
        return
    for part in re.split(r"^\$ ", text, flags=re.M)[1:]:
        command, _, output = part.partition("\n")
        yield command, output


def words_of(command: str) -> list[str]:
    """Return a command's words, without comment, environment and the path of the program."""
    words = shlex.split(command, comments=True)
    while words and re.match(r"[A-Z_]+=", words[0]):
        words.pop(0)
    if words and words[0] == "mpirun":
        words = words[3:]  # mpirun -n 2
    if words:
        words[0] = words[0].removeprefix(".venv/bin/")
    if words[:3] == ["python", "-m", "fem_snh"]:
        words[:3] = ["fem-snh"]
    return words


def _form(text: str) -> list[str]:
    """Return the lines of an output without its numbers and spaces."""
    lines = (_NUMBER.sub("#", line).split() for line in text.splitlines())
    return [" ".join(words) for words in lines if words]


def complete(data: dict[str, Any]) -> dict[str, Any]:
    """Return a scene file's tables with those that a fragment leaves out."""
    if "mesh" in data:
        return {"name": "scene"} | data
    material = data.get("material", {})
    if isinstance(material, dict):
        material = _MATERIAL | material
    return {"name": "fragment"} | _SCENE | data | {"material": material}


def run(page: Path) -> None:
    """Run a page in the present folder; raises what its blocks raise, with their line."""
    namespace: dict[str, Any] = {"__name__": "__main__"}
    for block in blocks(page):
        if block.kind in SHELL and measured(page, block):
            continue
        if block.note.startswith("file: "):
            shutil.copy(ROOT / block.note.removeprefix("file: "), ".")
        if block.file_name:
            Path(block.file_name).write_text(block.text, encoding="utf-8")
        if block.kind == "toml":
            _load(block)
        elif block.kind == "python" and not block.file_name:
            # Tracebacks name the page's line.
            code = "\n" * block.line + for_this_dolfinx(_quick(block))
            exec(compile(code, str(page), "exec"), namespace)
        elif block.kind in SHELL:
            for command, output in commands(block):
                _command(page, block, command, output)


def for_this_dolfinx(code: str) -> str:
    """Return a program with the lines that dolfinx 0.5 needs, where it is installed."""
    if "# dolfinx 0.5: " not in code or hasattr(import_module("dolfinx.fem"), "functionspace"):
        return code
    return re.sub(r"^.*\n# dolfinx 0\.5: (.*)", r"\n\1", code, flags=re.M)


def _quick(block: Block) -> str:
    """Return a Python block with the text replaced that its note names."""
    if not block.note.startswith("quick: "):
        return block.text
    old, arrow, new = block.note.removeprefix("quick: ").partition(" => ")
    assert arrow and old in block.text, f"line {block.line}: {block.note}"
    return block.text.replace(old, new)


def _load(block: Block) -> None:
    from fem_snh import scenes
    from fem_snh.materials import registry

    if block.file_name == "pyproject.toml":
        groups = tomllib.loads(block.text)["project"]["entry-points"]
        assert set(groups) <= {registry.GROUP, scenes.GROUP, scenes.FEATURES}, groups
    elif block.file_name and "mesh" in tomllib.loads(block.text):
        scenes.load(block.file_name)
    else:
        scenes.Scene.model_validate(complete(tomllib.loads(block.text)))


def _command(page: Path, block: Block, command: str, output: str) -> None:
    """Run a command of `fem-snh`; its exit code and the form of its output must be the page's."""
    from fem_snh import cli

    words = words_of(command)
    if not words or words[0] != "fem-snh" or command.startswith("mpirun"):
        return
    print(f"{page.name}:{block.line}: {command}", flush=True)
    printed = io.StringIO()
    with redirect_stdout(printed), redirect_stderr(printed):
        code = cli.main(words[1:])
    wanted = re.search(r"exit code (\d+)", block.note)
    expected = int(wanted[1]) if wanted else 0
    where = f"{page}:{block.line}: {command}"
    assert code == expected, f"{where}: exit code {code}\n{printed.getvalue()}"
    if output.strip():
        assert _form(output) == _form(printed.getvalue()), f"{where} prints\n{printed.getvalue()}"


def run_in(folder: Path, page: Path, log: Path) -> None:
    """Run a page in this process, which ends after it, with its output in a file."""
    with open(log, "wb") as file:
        os.dup2(file.fileno(), 1)
        os.dup2(file.fileno(), 2)
    os.chdir(folder)
    _run_program(page)


def _run_program(page: Path) -> None:
    # A page imports the files that it has written, and those at the root of the repository.
    sys.path[:0] = ["", str(ROOT)]
    sys.argv = [__file__, str(page)]
    run(page)


if __name__ == "__main__":
    _run_program(Path(sys.argv[1]).resolve())
