"""The parts of the package and their imports, read from the source."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from graphlib import TopologicalSorter
from pathlib import Path

import fem_snh
from generated.table import table

_PACKAGE = Path(fem_snh.__file__).parent


def markdown() -> str:
    """Return a table of the folders from the bottom up: what each is, and what it imports."""
    folders = {path.parent.name: path for path in _PACKAGE.glob("*/__init__.py")}
    arrows = {
        name: set(_imported_parts(path.parent)) & set(folders) for name, path in folders.items()
    }
    rows = []
    for name in TopologicalSorter(arrows).static_order():
        first = (ast.get_docstring(ast.parse(folders[name].read_text())) or "").partition("\n\n")[0]
        imported = ", ".join(sorted(arrows[name] - {name}))
        rows.append((f"`{name}/`", first.replace("\n", " "), imported))
    return table(("part", "what it is", "imports"), rows)


def _imported_parts(folder: Path) -> Iterator[str]:
    """Yield the first folder or module within the package of each import in a folder's files."""
    for path in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "fem_snh":
                for alias in node.names:
                    part = f"{node.module}.{alias.name}".split(".")[1]
                    if part != folder.name:
                        yield part
