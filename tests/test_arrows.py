"""Which part of the package may import which: the layers of docs/architecture."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from layers import ALLOWED, FORBIDDEN, LAYER, LAZY, THIRD_PARTY
from same_on_every_debian import SAME_ON_EVERY_DEBIAN

import fem_snh

PACKAGE = Path(fem_snh.__file__).parent


def part_of(path: Path) -> str:
    """Return the part that a file belongs to; "" for ``__init__`` files of the package and fem."""
    first, *rest = path.relative_to(PACKAGE).with_suffix("").parts
    if first == "fem" and rest != ["__init__"]:
        return f"fem.{rest[0]}"
    return "" if first in ("__init__", "fem") else first


def imports(path: Path) -> set[str]:
    """Return the full names of all that a file imports, at its top or inside functions."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: expected absolute imports"
            module = node.module or ""
            found |= {f"{module}.{alias.name}" for alias in node.names}
    return found


def imported_parts(names: set[str]) -> set[str]:
    """Return the parts of the package among imported names."""
    modules = (name.split(".")[1:] for name in names if name.startswith("fem_snh."))
    parts = {f"fem.{m[1]}" if m[0] == "fem" and len(m) > 1 else m[0] for m in modules}
    return parts & set(LAYER)


FILES = sorted(PACKAGE.rglob("*.py"))
every_file = pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))


def test_every_part_has_a_layer():
    assert {part_of(path) for path in FILES} - {""} == set(LAYER)


@every_file
def test_imports_point_down(path):
    part = part_of(path)
    if not part:
        return  # fem_snh/__init__.py imports lazily; see below
    known = (
        imported_parts(imports(path))
        - {part}
        - LAZY.get(path.relative_to(PACKAGE).as_posix(), set())
    )
    allowed = ALLOWED.get(part, set())
    upwards = {other for other in known - allowed if LAYER[other] >= LAYER[part]}
    assert not upwards, f"{part} must not import {sorted(upwards)}"
    assert known <= ALLOWED.get(part, known), f"{part} must not import {sorted(known - allowed)}"


@every_file
def test_third_party_packages(path):
    part = part_of(path)
    found = {name.split(".")[0] for name in imports(path)}
    for package, homes in THIRD_PARTY.items():
        assert package not in found or part in homes, f"{part} must not import {package}"
    assert not found & FORBIDDEN.get(part, set())


@every_file
def test_the_package_does_not_import_benchmarks(path):
    """Benchmarks and tests import the package; it is installed without them."""
    found = {name.split(".")[0] for name in imports(path)}
    assert not found & {"benchmarks", "demos", "tests"}


def loaded_after(code: str) -> set[str]:
    """Return the top-level packages that a new Python process has imported after some code."""
    code += "\nimport sys\nprint(' '.join(sorted({name.split('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


#: Packages that take long to import, or need MPI or a display.
HEAVY = {
    "dolfinx",
    "petsc4py",
    "slepc4py",
    "mpi4py",
    "gmsh",
    "basix",
    "ffcx",
    "pyvista",
    "vtkmodules",
}


@pytest.mark.parametrize(
    "code, also",
    [
        ("import fem_snh", {"numpy", "sympy", "scipy", "pydantic", "rich"}),
        ("import fem_snh.cli", {"numpy", "sympy", "scipy", "pydantic"}),
        ("import fem_snh; assert 'neo_hookean' in fem_snh.materials()", set()),
        (
            "import fem_snh; fem_snh.material('neo_hookean').energy([[[1, 0, 0]] * 3])",
            set(),
        ),
        ("from fem_snh import scenes; [scenes.load(name) for name in scenes.names()]", set()),
        ("from fem_snh.viewing import plots, render; from fem_snh.assembly import elements", set()),
    ],
)
def test_these_import_nothing_heavy(code, also):
    assert not loaded_after(code) & (HEAVY | also)


def test_lazy_names_exist():
    assert {"material", "materials", "run", "Result", "BadInput"} <= set(fem_snh.__all__)
    for name in fem_snh.__all__:
        assert getattr(fem_snh, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = fem_snh.nothing


def test_files_that_debian_13_leaves_out_exist():
    here = {path.stem for path in Path(__file__).parent.glob("test_*.py")}
    assert here >= SAME_ON_EVERY_DEBIAN
