"""Benchmarks of the program for its own documentation: each prints one JSON object per row.

A benchmark is a module or package here with a function ``rows(**options)`` that yields dicts; its
module docstring is its help text. A row with ``"ok": false`` misses a limit. The other modules are
what the benchmarks share. Nothing here is installed with the package.
"""

from __future__ import annotations

import ast
import inspect
import json
import os
from collections.abc import Callable, Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from fem_snh.errors import choose, unknown_name

Row = dict[str, Any]

_HERE = Path(__file__).parent


def _sources() -> dict[str, ast.Module]:
    """Return the parsed source of every benchmark by name; nothing is imported."""
    found = {}
    for path in sorted([*_HERE.glob("*.py"), *_HERE.glob("*/__init__.py")]):
        name = path.parent.name if path.name == "__init__.py" else path.stem
        if path.parent == _HERE and path.name.startswith("__"):
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        if any(isinstance(node, ast.FunctionDef) and node.name == "rows" for node in tree.body):
            found[name] = tree
    return dict(sorted(found.items()))


#: The names of all benchmarks.
NAMES = tuple(_sources())


def main(name: str, options: dict[str, Any]) -> int:
    """Run one benchmark and print its rows as JSON on rank 0. Collective.

    Returns
    -------
    int
        0 if every row that has ``ok`` is ok, else 1.

    Raises
    ------
    BadInput
        For an unknown benchmark or option.
    """
    module = import_module(f"{__name__}.{choose('benchmark', name, NAMES)}")
    rows: Callable[..., Iterator[Row]] = module.rows
    known = inspect.signature(rows).parameters
    for key in options:
        if key not in known:
            raise unknown_name(f"option of benchmark {name}", key, known)
    from mpi4py import MPI

    passed = True
    for row in rows(**options):
        passed &= bool(row.get("ok", True))
        if MPI.COMM_WORLD.rank == 0:
            print(json.dumps({"bench": name} | row), flush=True)
    return 0 if passed else 1


def help_text(name: str = "") -> str:
    """Return the list of benchmarks, or the description and options of one of them."""
    sources = _sources()
    if not name:
        width = max(map(len, sources))
        lines = [f"  {key:<{width}}  {_summary(tree)}" for key, tree in sources.items()]
        return "benchmarks:\n" + "\n".join(lines)
    tree = sources[choose("benchmark", name, NAMES)]
    return f"{ast.get_docstring(tree)}\n\noptions:\n{_options(tree)}\n\n{_rows_docstring(tree)}"


def _summary(tree: ast.Module) -> str:
    """Return the first line of a module's docstring."""
    return (ast.get_docstring(tree) or "").partition("\n")[0]


def _rows_function(tree: ast.Module) -> ast.FunctionDef:
    """Return the definition of ``rows``."""
    return next(n for n in tree.body if isinstance(n, ast.FunctionDef) and n.name == "rows")


def _options(tree: ast.Module) -> str:
    """Return the options of ``rows`` with their defaults, one per line."""
    arguments = _rows_function(tree).args
    pairs = zip(arguments.args, arguments.defaults, strict=True)
    return "\n".join(f"  --{arg.arg:<12} default: {ast.unparse(value)}" for arg, value in pairs)


def _rows_docstring(tree: ast.Module) -> str:
    """Return the docstring of ``rows``."""
    return ast.get_docstring(_rows_function(tree)) or ""


def split_list(text: str) -> list[str]:
    """Return the items of a comma list."""
    return [item for item in str(text).split(",") if item]


def policy(word: str) -> dict[str, Any]:
    """Return Hessian and globalization of "clamp" (a line search) or "clamp+trust_region"."""
    hessian, _, globalization = word.partition("+")
    return {"hessian": hessian, "globalization": globalization or "linesearch"}


def search_path() -> dict[str, str]:
    """Return PYTHONPATH for a child that imports `benchmarks` from any working directory."""
    paths = [str(_HERE.parent), os.environ.get("PYTHONPATH", "")]
    return {"PYTHONPATH": os.pathsep.join(path for path in paths if path)}
