"""The pages are of this program: every block of code is of a kind that a test runs.

`pages.py` says what the kinds are. Commands are checked and run by test_docs_commands.py.
"""

from __future__ import annotations

import ast
import doctest
import inspect
import multiprocessing
import re
import subprocess
import sys
from importlib import import_module
from multiprocessing.context import ForkServerContext
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import numpy as np
import pytest
from pages import (
    DEMOS,
    PAGES,
    ROOT,
    SHELL,
    blocks,
    blocks_of,
    commands,
    demo_text,
    measured,
    name_of,
    run_in,
    runner,
)
from time_scenes import in_time

import fem_snh
from fem_snh import cli, scenes
from fem_snh.solver.options import OPTIONS

pytestmark = pytest.mark.one_debian

#: SNES options of PETSc's own that pages name.
PETSC_OPTIONS = r"snes_(atol|rtol|stol|max_it|view|monitor|converged_reason|error_if.*|type|tr_)"
#: Directives of MyST and of docs/_ext: Sphinx runs them, and `make docs` fails if one does.
DIRECTIVES = {
    "{csv-table}",
    "{admonition}", "{bibliography}", "{eval-rst}", "{generated}", "{image}", "{literalinclude}",
    "{toctree}",
}  # fmt: skip


def runnable(page: Path) -> bool:
    """Whether a page has a block that is run as it is."""
    shell = (b for b in blocks(page) if b.kind in SHELL and not measured(page, b))
    return any(b.kind in ("python", "toml") for b in blocks(page)) or any(shell)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_block_is_of_a_kind_that_is_run(page: Path) -> None:
    """Python, TOML, commands with their output, a source file or a directive: no other block."""
    for block in blocks(page):
        where = f"{name_of(page)}:{block.line}: {block.text[:60]!r}"
        known = block.kind in ("python", "toml", *SHELL) or block.kind in DIRECTIVES
        assert known or block.file_name, f"{where}: a {block.kind or 'indented'} block"
        if block.kind in SHELL:
            found = list(commands(block))
            assert found, f"{where}: no command"
            assert block.text.startswith("$ ") or "$ " not in block.text, f"{where}: whose output?"
            assert (ROOT / (runner(block) or "tests")).exists(), where
            if measured(page, block):
                assert not any(output.strip() for _, output in found), f"{where}: output not run"


@pytest.mark.parametrize("demo", DEMOS, ids=lambda demo: demo.stem)
def test_the_blocks_of_a_demos_page_are_the_demo(demo: Path) -> None:
    """The Python blocks are run by test_demos.py; the others are commands."""
    found = blocks_of(demo_text(demo))
    assert {block.kind for block in found} == {"bash", "python"}
    code = "".join(block.text for block in found if block.kind == "python")
    assert ast.dump(ast.parse(code)) == ast.dump(ast.parse(demo.read_text()))


#: What most pages import, but for MPI, which a process must not start before it is forked.
PRELOADED = [
    "ffcx", "fem_snh.cli", "fem_snh.scenes", "gmsh", "matplotlib.pyplot", "pandas", "pyvista",
    "scipy.optimize", "sympy",
]  # fmt: skip


@pytest.fixture(scope="module")
def processes() -> ForkServerContext:
    """Return a context whose processes are forked from one that has imported `PRELOADED` alone."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(PRELOADED)
    return context


@pytest.mark.parametrize("page", [page for page in PAGES if runnable(page)], ids=name_of)
def test_page_runs(page: Path, tmp_path: Path, processes: ForkServerContext) -> None:
    folder, log = tmp_path / "folder", tmp_path / "log.txt"
    folder.mkdir()
    process = processes.Process(target=run_in, args=(folder, page, log))
    process.start()
    process.join(300)
    process.kill()
    assert process.exitcode == 0, log.read_text()


def test_pages_name_what_exists() -> None:
    """Modules, functions and classes by their dotted names, and options of `fem-snh`, in texts."""
    dotted = re.compile(r"(?<![\w./-])((?:fem_snh|benchmarks)(?:\.[A-Za-z]\w*)+)(?!\w*[/-])")
    parsers = cli.parsers().values()
    options = {option for parser in parsers for option in parser._option_string_actions}
    for page in [*PAGES, *DEMOS, ROOT / "CHANGELOG.md"]:
        text = page.read_text(encoding="utf-8")
        for name in set(dotted.findall(text)) - {scenes.FEATURES}:  # a group of entry points
            if Path(name).suffix not in (".py", ".toml"):
                resolve_name(name)  # raises, if it is none
        for words in re.findall(r"(?<!`)`(--[a-z][^`\n]*)`(?!`)", text):
            option = words.split()[0].partition("=")[0]
            known = option in options or f'"{option}"' in text  # a demo's own
            assert known or option == "--version", f"{name_of(page)}: {option}"
        for option in re.findall(r"`-(?:snh_)?(snes_\w+)[^`]*`", text):
            known = option in OPTIONS or re.fullmatch(PETSC_OPTIONS, option)
            assert known, f"{name_of(page)}: -{option}"


def test_run_json_page_has_every_key(tmp_path: Path) -> None:
    """The tables of docs/reference/run_json.md are the keys of a run.json."""
    text = (ROOT / "docs/reference/run_json.md").read_text(encoding="utf-8")
    listed = set(re.findall(r"^\| `(\w+)`", text, re.M))
    asked = {"modes": {"count": 1}, "error": True, "stability": True, "units": "mm, N, MPa"}
    record = fem_snh.run("twist", cells=2, progress=False, **asked).record
    moved = fem_snh.run(in_time({"duration": 0.1, "steps": 1, "tolerance": 1.0}), progress=False)
    found = {*record, *record["steps"][-1], *record["seconds"], *record["modes"]}
    found |= {*moved.record, *moved.steps[0]}
    assert found <= listed
    assert listed - found <= {
        "accuracy", "bones", "cavities", "cell_groups", "contacts",
        "examined_lbfgs", "examined_linear", "examined_newton", "fields", "fields_at", "files",
        "lagged_change", "linear_residual", "mixed_newton", "mixed_reason", "moments", "notes",
        "obstacles", "resumed", "rigid", "self_contact", "solves", "stabilisation",
        "static_condensation", "volumes",
    }  # fmt: skip


def test_reference_pages_are_those_of_the_program() -> None:
    """In a process of its own: other tests add tables to scenes."""
    command = [sys.executable, str(ROOT / "docs/reference/make.py"), "--check"]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, f"python docs/reference/make.py: {done.stdout}{done.stderr}"


#: The modules whose docstrings have an example, and the names that it uses without an import.
EXAMPLES: dict[str, dict[str, Any]] = {
    "fem_snh": {"F": np.eye(3)},
    "fem_snh.scenes": {},
    "fem_snh.kernels.reports": {"fem_snh": fem_snh},
    "fem_snh.studies.sweep": {},
}
#: Functions that take minutes: only the arguments of the example are checked here.
STUDIES = {"sweep"}
#: Examples that need a mesh, and the test that runs the same lines.
EXAMPLES_ELSEWHERE = {
    "fem_snh/program_results.py": "tests/accuracy/test_error_of_programs.py",
    "fem_snh/dynamic_problem.py": "tests/problem/test_dynamic_problem.py",
    "fem_snh/nonlinear_problem.py": "tests/problem/test_nonlinear_problem.py",
    "fem_snh/scenes/schema.py": "tests/scenes/test_scene_build.py",
    "fem_snh/runs/start.py": "tests/runs/test_start_from_run.py",
}


def test_examples_of_docstrings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The examples on the pages of the reference run, with fewer cells."""
    monkeypatch.chdir(tmp_path)
    sources = (ROOT / "fem_snh").rglob("*.py")
    found = {name_of(source) for source in sources if ">>> " in source.read_text()}
    assert len(EXAMPLES) == len(found - set(EXAMPLES_ELSEWHERE))
    assert all((ROOT / test).exists() for test in EXAMPLES_ELSEWHERE.values())
    for name, names in EXAMPLES.items():
        module = import_module(name)
        names = vars(module) | names
        for example in doctest.DocTestParser().get_examples(module.__doc__ or ""):
            if "Problem(" in example.source:  # as in EXAMPLES_ELSEWHERE
                continue
            call = getattr(ast.parse(example.source).body[0], "value", None)
            study = next((n for n in ast.walk(call) if _is_study(n)), None) if call else None
            if study:
                keys = {key.arg: ast.literal_eval(key.value) for key in study.keywords}
                inspect.signature(names[study.func.id]).bind(*study.args, **keys)
            else:
                exec(example.source.replace("cells=15", "cells=2"), names)


def _is_study(node: ast.AST) -> bool:
    return isinstance(node, ast.Call) and getattr(node.func, "id", "") in STUDIES
