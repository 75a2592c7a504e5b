"""How many defects the tests catch: mutations of the package, one at a time, in a copy of the tree.

Each file of tests runs once with a record of the functions that it enters. A mutation is then met
with the files that enter its function, the quickest first, until one fails.
"""

from __future__ import annotations

import ast
import copy
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from benchmarks import Row

_ROOT = Path(__file__).resolve().parents[1]
_OPPOSITE: dict[type, type] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Lt: ast.Gt,
    ast.Gt: ast.Lt, ast.LtE: ast.GtE, ast.GtE: ast.LtE, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
}  # fmt: skip
_KINDS = {ast.Add: "sign", ast.Sub: "sign", ast.Mult: "factor", ast.Div: "factor"}
#: What is not mutated: texts, errors, types.
_SKIPPED = (ast.JoinedStr, ast.Raise, ast.Assert, ast.arguments, ast.AnnAssign)
#: What a file must take longer than when it was recorded, to count as one that does not end.
_SLOWER, _SECONDS = 5, 60
_entered: set[Any] = set()


class Mutation(NamedTuple):
    """A node of the function that begins in a line of a source, and what replaces the node."""

    kind: str
    path: str
    function: int
    node: Any
    new: Any


def _mutated(node: ast.AST) -> tuple[str, ast.AST] | None:
    """Return the kind of mutation of a node, and what replaces the node."""
    new: Any = copy.deepcopy(node)
    match new:
        case ast.BinOp() if type(new.op) in _KINDS:
            kind = _KINDS[type(new.op)]
            new.op = _OPPOSITE[type(new.op)]()
            return kind, new
        case ast.Compare(ops=[operator]) if type(operator) in _OPPOSITE:
            new.ops = [_OPPOSITE[type(operator)]()]
            return "comparison", new
        case ast.Subscript(slice=ast.Constant(value=int(index))):
            new.slice = ast.Constant(index + 1)
            return "index", new
        case ast.Assign(targets=[ast.Attribute() | ast.Subscript()]) | ast.Expr(value=ast.Call()):
            return "state", ast.Pass()
    return None


def mutations(path: Path) -> Iterator[Mutation]:
    """Yield the mutations of a module, in its functions."""

    def visit(node: ast.AST, function: int) -> Iterator[Mutation]:
        for child in ast.iter_child_nodes(node):
            first = function
            if isinstance(child, ast.FunctionDef):
                first = min([child.lineno, *(d.lineno for d in child.decorator_list)])
            elif isinstance(child, _SKIPPED):
                continue
            elif function and (found := _mutated(child)):
                yield Mutation(found[0], str(path.relative_to(_ROOT)), function, child, found[1])
            yield from visit(child, first)

    yield from visit(ast.parse(path.read_text(encoding="utf-8")), 0)


def apply(mutation: Mutation, source: bytes) -> bytes:
    """Return the source with the text of the mutated node replaced."""
    node, lines = mutation.node, source.splitlines(keepends=True)
    start = sum(map(len, lines[: node.lineno - 1])) + node.col_offset
    end = sum(map(len, lines[: node.end_lineno - 1])) + node.end_col_offset
    text = ast.unparse(ast.fix_missing_locations(mutation.new))
    text = f"({text})" if isinstance(node, ast.expr) else text
    return source[:start] + text.encode() + source[end:]


def pytest_sessionstart() -> None:
    """Begin to record, where pytest has this module as a plugin."""
    sys.settrace(lambda frame, event, argument: _entered.add(frame.f_code))


def pytest_sessionfinish() -> None:
    sys.settrace(None)
    package = str(Path.cwd() / "fem_snh") + os.sep
    codes = [code for code in _entered if code.co_filename.startswith(package)]
    names = {f"fem_snh/{c.co_filename.removeprefix(package)}:{c.co_firstlineno}" for c in codes}
    Path(os.environ["ENTERED"]).write_text(json.dumps(sorted(names)))


def _passes(tree: Path, test: str, seconds: float, *options: str, **variables: str) -> bool:
    """Return whether a file of tests passes, within the time."""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", *options, test]
    env = os.environ | {"PYTHONPATH": str(tree), "OMP_NUM_THREADS": "1"} | variables
    quiet: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    try:
        return not subprocess.run(command, cwd=tree, env=env, timeout=seconds, **quiet).returncode
    except subprocess.TimeoutExpired:
        return False


def _copy(tree: Path) -> Path:
    ignored = shutil.ignore_patterns(".*", "__pycache__", "*.egg-info", "build", "dist", "out")
    shutil.copytree(_ROOT, tree, ignore=ignored)
    (tree / ".venv").symlink_to(_ROOT / ".venv")
    return tree


def _recorded(tree: Path) -> dict[str, tuple[float, list[str]]]:
    """Return the seconds of each file of tests that passes, and the functions that it enters."""
    found = {}
    for path in sorted(tree.glob("tests/*/test_*.py")):
        start, entered, test = time.perf_counter(), tree / "entered", str(path.relative_to(tree))
        if _passes(tree, test, 3600, "-p", "benchmarks.mutations", ENTERED=str(entered)):
            found[test] = (time.perf_counter() - start, json.loads(entered.read_text()))
    return found


def rows(number: int = 60, seed: int = 1, record: str = "build/entered.json") -> Iterator[Row]:
    """Yield one row per mutation, then the number of the caught ones.

    Parameters
    ----------
    number, seed : int
        Mutations, of the five kinds in turn, and the seed by which they are chosen.
    record : path
        Functions that each file enters, and its seconds; written if it does not exist, which takes
        as long as all tests. Functions that are entered in child processes only are not in it.

    Yields
    ------
    dict
        ``caught``: the file of tests that failed, or null; ``files``: how many ran.
    """
    kinds: dict[str, list[Mutation]] = {}
    for path in sorted((_ROOT / "fem_snh").rglob("*.py")):
        for mutation in mutations(path):
            kinds.setdefault(mutation.kind, []).append(mutation)
    generator = random.Random(seed)
    names = sorted(kinds)
    chosen = [generator.choice(kinds[names[i % len(names)]]) for i in range(number)]
    with tempfile.TemporaryDirectory() as folder:
        tree = _copy(Path(folder, "tree"))
        if not Path(record).exists():
            Path(record).parent.mkdir(parents=True, exist_ok=True)
            Path(record).write_text(json.dumps(_recorded(tree)))
        files = sorted(json.loads(Path(record).read_text()).items(), key=lambda item: item[1][0])
        caught = 0
        for mutation in chosen:
            source = (_ROOT / mutation.path).read_bytes()
            (tree / mutation.path).write_bytes(apply(mutation, source))
            place, ran, by = f"{mutation.path}:{mutation.function}", 0, None
            for test, (seconds, entered) in files:
                if place in entered:
                    ran += 1
                    cache = str(Path(folder, f"cache{caught}"))  # of the mutated kernels
                    kernels = mutation.path.split("/")[1] in ("kernels", "materials")
                    variables = {"FEM_SNH_CACHE": cache} if kernels else {}
                    if not _passes(tree, test, _SLOWER * seconds + _SECONDS, **variables):
                        by = test
                        break
            (tree / mutation.path).write_bytes(source)
            caught += by is not None
            yield {
                "kind": mutation.kind,
                "place": f"{mutation.path}:{mutation.node.lineno}",
                "was": ast.unparse(mutation.node),
                "becomes": ast.unparse(mutation.new),
                "caught": by,
                "files": ran,
            }
    yield {"seed": seed, "mutations": number, "caught": caught}
