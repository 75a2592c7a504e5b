"""Who may know whom: the arrows between the parts of the package."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import fem_snh

PACKAGE = Path(fem_snh.__file__).parent

#: From the bottom up: a part knows those of lower layers, and of its own layer itself alone.
#: A part is a folder or a file of the package; the files of ``fem`` are parts of their own.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("errors", "choices"),
    ("atomic_files", "references"),
    ("_petsc", "materials", "fem.elements"),
    ("_dolfinx",),
    ("kernels", "fem.gmsh_input"),
    ("linalg",),
    ("fem.mesh", "fem.numbering", "fem.block_sparsity", "fem.near_null_space"),
    ("scenes",),
    ("fem.ufl_forms", "fem.assembled_matrix"),
    ("fem.terms", "fem.unknowns", "fem.boundary_conditions"),
    ("fem.taylor_hood", "fem.measures"),
    ("fem.problem",),
    ("fem.probes", "fem.initial_state"),
    ("fem.eigenproblem",),
    ("fem.modes",),
    ("solver",),
    ("runs",),
    ("plots", "render", "doctor"),
    ("studies",),
    ("reports",),
    ("cli",),
    ("__main__",),
)
LAYER = {part: number for number, layer in enumerate(LAYERS) for part in layer}

#: What a part may know where the layers alone would allow more.
ONLY = {
    "choices": {"errors"},
    "materials": {"errors", "references"},
    "kernels": {"errors", "choices", "materials"},
    "linalg": {"errors", "_petsc", "kernels"},
    "_petsc": {"errors"},
    "fem.elements": {"errors"},
    "fem.gmsh_input": {"errors", "_dolfinx"},
    "fem.mesh": {"errors", "_dolfinx", "fem.gmsh_input"},
    "fem.ufl_forms": {"errors", "materials"},
    "fem.numbering": {"_dolfinx"},
    "fem.block_sparsity": set(),
    "fem.near_null_space": set(),
    "fem.assembled_matrix": {"errors", "_petsc", "fem.numbering", "fem.block_sparsity"},
    "fem.boundary_conditions": {"_dolfinx", "fem.mesh"},
    "fem.measures": {"_dolfinx", "fem.mesh", "fem.boundary_conditions"},
    "fem.eigenproblem": {"errors", "fem.terms", "fem.problem"},
    "fem.modes": {"errors", "fem.problem", "fem.eigenproblem"},
    "fem.probes": {"errors", "_dolfinx"},
    "fem.initial_state": {"_dolfinx", "fem.problem"},
    "scenes": {"errors", "choices", "references", "materials", "fem.elements", "fem.mesh"},
    "plots": {"errors", "render"},
    "render": {"errors"},
    "reports": {"errors", "materials", "kernels", "plots"},  # plots when asked to draw
    "doctor": {"errors"},
    # Given a problem, the solver needs no more of one than its methods.
    "solver": {"errors", "choices", "_petsc", "linalg"},
}

#: Upward imports inside a method: `Material.report` and `Material.ufl`.
LAZY = {"kernels/pointwise.py": {"reports", "fem.ufl_forms"}}

#: Packages from outside that only some parts may import.
OUTSIDE = {
    "dolfinx": {"_dolfinx"},
    "basix": {"_dolfinx"},
    "ffcx": {"_dolfinx"},
    "ufl": {"_dolfinx", "fem.ufl_forms", "fem.terms", "fem.taylor_hood"},
    "gmsh": {"fem.gmsh_input"},
    "pyvista": {"render"},
    "matplotlib": {"plots", "render"},
    "pydantic": {"scenes"},
    "slepc4py": {"fem.eigenproblem", "fem.modes"},
}
#: And what some parts may not.
FORBIDDEN = {
    "materials": {"mpi4py", "petsc4py", "numpy", "cffi"},
    "kernels": {"mpi4py", "petsc4py"},
    "reports": {"mpi4py", "petsc4py"},
    "scenes": {"mpi4py", "petsc4py"},
    "fem.elements": {"mpi4py", "petsc4py"},
    "plots": {"mpi4py", "petsc4py"},
    "render": {"mpi4py", "petsc4py"},
    "errors": {"mpi4py", "petsc4py", "numpy"},
    "choices": {"mpi4py", "petsc4py", "numpy"},
}


def part_of(path: Path) -> str:
    """The part that a file of the package belongs to; "" for the package itself."""
    first, *rest = path.relative_to(PACKAGE).with_suffix("").parts
    if first == "fem" and rest != ["__init__"]:
        return f"fem.{rest[0]}"
    return "" if first in ("__init__", "fem") else first


def imports(path: Path) -> set[str]:
    """Full names of all that a file imports, at its top or inside functions."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative imports hide the arrows"
            module = node.module or ""
            found |= {f"{module}.{alias.name}" for alias in node.names}
    return found


def own(names: set[str]) -> set[str]:
    """The parts of the package among imported names."""
    modules = (name.split(".")[1:] for name in names if name.startswith("fem_snh."))
    parts = {f"fem.{m[1]}" if m[0] == "fem" and len(m) > 1 else m[0] for m in modules}
    return parts & set(LAYER)


FILES = sorted(PACKAGE.rglob("*.py"))
each = pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(PACKAGE)))


def test_every_part_has_a_place():
    assert {part_of(path) for path in FILES} - {""} == set(LAYER)


@each
def test_arrows_point_down(path):
    me = part_of(path)
    if not me:
        return  # the package's front door opens the parts when asked; see below
    known = own(imports(path)) - {me} - LAZY.get(path.relative_to(PACKAGE).as_posix(), set())
    upwards = {part for part in known if LAYER[part] >= LAYER[me] and part not in ONLY.get(me, ())}
    assert not upwards, f"{me} must not know {sorted(upwards)}"
    assert known <= ONLY.get(me, known), f"{me} must not know {sorted(known - ONLY[me])}"


@each
def test_outside_packages_stay_where_they_belong(path):
    me = part_of(path)
    found = {name.split(".")[0] for name in imports(path)}
    for package, homes in OUTSIDE.items():
        assert package not in found or me in homes, f"{me} must not import {package}"
    assert not found & FORBIDDEN.get(me, set())


def loaded_after(code: str) -> set[str]:
    """The top-level packages in memory after some code, in a Python of its own."""
    code += "\nimport sys\nprint(' '.join(sorted({name.split('.')[0] for name in sys.modules})))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return set(done.stdout.split())


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
        ("from fem_snh import plots, render; from fem_snh.fem import elements", set()),
    ],
)
def test_light_things_load_nothing_heavy(code, also):
    assert not loaded_after(code) & (HEAVY | also)


def test_everything_is_there_when_asked_for():
    assert {"material", "materials", "run", "Result", "BadInput"} <= set(fem_snh.__all__)
    for name in fem_snh.__all__:
        assert getattr(fem_snh, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = fem_snh.nothing
