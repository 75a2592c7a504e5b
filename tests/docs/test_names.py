"""Names in docstrings and pages are those of the package: classes, functions, modules."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from paths import ROOT

pytestmark = pytest.mark.one_debian

SOURCES = sorted((ROOT / "fem_snh").rglob("*.py"))
PAGES = [*sorted((ROOT / "docs").rglob("*.md")), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]
#: `name`, which Sphinx links; neither ``code`` nor a role such as :math:`x` or {cite}`Smith2018`.
LINKED = re.compile(r"(?<![`:}\w])`([A-Za-z_][\w.]*)`(?!`)")
#: CamelCase, as in the type of a parameter.
CLASS = re.compile(r"\b(?:[A-Z]+[a-z]+){2,}\b|\b[A-Z]{2,}[a-z]\w+\b")
TYPE = re.compile(r"^\s*[\w, *]+ : (.*)$", re.M)
#: Classes and functions of other packages, gmsh's options.
FOREIGN = {"DirichletBC", "BooleanFragments", "MatSetValues"}


def identifiers() -> set[str]:
    """Return all identifiers of the package's source and headers, and the names of its modules."""
    found = set(FOREIGN)
    for header in (ROOT / "fem_snh").rglob("*.h"):
        found.update(re.findall(r"\w+", header.read_text()))
    for path in SOURCES:
        found.update(path.relative_to(ROOT).with_suffix("").parts)
        for node in ast.walk(ast.parse(path.read_text())):
            for key in ("name", "id", "attr", "arg", "asname"):
                if isinstance(name := getattr(node, key, None), str):
                    found.update(name.split("."))
    return found


def docstrings() -> Iterator[tuple[Path, str]]:
    kinds = (ast.ClassDef, ast.FunctionDef, ast.Module)
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, kinds) and (text := ast.get_docstring(node)):
                yield path, text


def test_names_in_docstrings_exist() -> None:
    known, unknown = identifiers(), list[str]()
    for path, text in docstrings():
        names = {name.split(".")[-1] for name in LINKED.findall(text)}
        names |= {name for kind in TYPE.findall(text) for name in CLASS.findall(kind)}
        unknown += [f"{path.relative_to(ROOT)}: {name}" for name in sorted(names - known)]
    assert not unknown


def test_names_in_pages_exist() -> None:
    """Of code in backticks, what looks like a class, or is a part of the package."""
    known, unknown = identifiers(), list[str]()
    for path in PAGES:
        text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.S | re.M)
        names = LINKED.findall(text)
        chosen = {n.split(".")[-1] for n in names if n.startswith("fem_snh.") or CLASS.fullmatch(n)}
        unknown += [f"{path.relative_to(ROOT)}: {name}" for name in sorted(chosen - known)]
    assert not unknown
