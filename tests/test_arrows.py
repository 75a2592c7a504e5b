"""Which part of the package may import which: the layers of docs/architecture."""

from __future__ import annotations

import ast
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import SAME_ON_EVERY_DEBIAN

import fem_snh

PACKAGE = Path(fem_snh.__file__).parent

#: From the bottom up. A part imports parts of lower layers only, none of its own layer. A part is a
#: folder or a file of the package; each file of ``fem`` is a part.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("errors", "choices", "output_fields"),
    ("atomic_files", "references"),
    ("_petsc", "materials", "fem.elements"),
    ("_dolfinx",),
    ("kernels", "fem.gmsh_input"),
    ("linalg",),
    ("fem.mesh", "fem.numbering", "fem.block_sparsity", "fem.near_null_space"),
    ("scenes", "fem.ufl_frame", "fem.matrix_layout", "fem.regions"),
    ("fem.ufl_stretches",),
    ("fem.ufl_forms", "fem.assembled_matrix", "fem.element_tables"),
    ("fem.terms", "fem.unknowns", "fem.boundary_conditions"),
    ("fem.taylor_hood", "fem.measures"),
    ("fem.problem",),
    ("fem.create_problem", "fem.probes", "fem.initial_state", "fem.nodal_projection"),
    ("fem.dolfinx_problem", "fem.stress_fields"),
    ("fem.field_values", "fem.eigenproblem"),
    ("fem.modes",),
    ("solver",),
    ("runs", "nonlinear_problem"),
    ("plots", "render", "doctor"),
    ("view",),
    ("studies",),
    ("reports",),
    ("cli",),
    ("__main__",),
)
LAYER = {part: number for number, layer in enumerate(LAYERS) for part in layer}

#: The parts that a part may import, where the layers alone would allow more.
ALLOWED = {
    "choices": {"errors"},
    "output_fields": set(),
    "materials": {"errors", "references"},
    "kernels": {"errors", "choices", "materials"},
    "linalg": {"errors", "_petsc", "kernels"},
    "_petsc": {"errors"},
    "fem.elements": {"errors"},
    "fem.gmsh_input": {"errors", "_dolfinx"},
    "fem.mesh": {"errors", "_dolfinx", "fem.gmsh_input"},
    "fem.ufl_frame": set(),
    "fem.ufl_stretches": {"materials", "kernels", "fem.ufl_frame"},
    "fem.ufl_forms": {"errors", "materials", "fem.ufl_frame", "fem.ufl_stretches"},
    "fem.numbering": {"_dolfinx"},
    "fem.block_sparsity": set(),
    "fem.near_null_space": set(),
    "fem.matrix_layout": {"errors", "fem.numbering", "fem.block_sparsity"},
    "fem.assembled_matrix": {
        "_petsc",
        "kernels",
        "fem.numbering",
        "fem.block_sparsity",
        "fem.matrix_layout",
    },
    "fem.regions": {"errors", "_dolfinx", "kernels", "fem.mesh"},
    "fem.boundary_conditions": {"_dolfinx", "fem.mesh"},
    "fem.measures": {"_dolfinx", "fem.mesh", "fem.boundary_conditions"},
    "fem.eigenproblem": {"errors", "fem.terms", "fem.problem"},
    "fem.modes": {"errors", "fem.problem", "fem.eigenproblem"},
    "fem.probes": {"errors", "_dolfinx"},
    "fem.initial_state": {"_dolfinx", "fem.problem"},
    "scenes": {
        "errors",
        "choices",
        "output_fields",
        "references",
        "materials",
        "fem.elements",
        "fem.mesh",
    },
    "plots": {"errors", "render"},
    "render": {"errors", "output_fields", "atomic_files"},
    "view": {"errors", "atomic_files", "plots", "render"},
    "reports": {"errors", "materials", "kernels", "plots"},  # plots: `Report.plot`
    "doctor": {"errors"},
    # The solver calls methods of a problem (solver/protocol.py); it does not import fem.
    "solver": {"errors", "choices", "_petsc", "linalg"},
}

#: Upward imports inside a method: `Material.report` and `Material.ufl`.
LAZY = {"kernels/pointwise.py": {"reports", "fem.ufl_forms"}}

#: Third-party packages that only these parts may import.
THIRD_PARTY = {
    "dolfinx": {"_dolfinx"},
    "basix": {"_dolfinx"},
    "ffcx": {"_dolfinx"},
    "ufl": {
        "_dolfinx",
        "fem.ufl_frame",
        "fem.ufl_stretches",
        "fem.ufl_forms",
        "fem.terms",
        "fem.taylor_hood",
        "fem.nodal_projection",
    },
    "gmsh": {"fem.gmsh_input"},
    "pyvista": {"render", "view"},
    "matplotlib": {"plots", "render"},
    "pydantic": {"scenes"},
    "slepc4py": {"fem.eigenproblem", "fem.modes"},
}
#: Third-party packages that these parts may not import: they work without MPI and PETSc.
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
        ("from fem_snh import plots, render; from fem_snh.fem import elements", set()),
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
