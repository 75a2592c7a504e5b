"""Which part of the package may import which: the layers of docs/architecture."""

from __future__ import annotations

import ast
import functools
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

import pytest

import fem_snh

pytestmark = pytest.mark.one_debian

PACKAGE = Path(fem_snh.__file__).parent

# --- the rules ------------------------------------------------------------------------------------

#: A part is a folder of the package. It imports parts that stand before it in this order.
PARTS = (
    "materials", "geometry", "tables", "_dolfinx", "viewing", "kernels", "mesh", "linalg", "solver",
    "assembly", "terms", "contact", "scenes", "studies", "problem", "accuracy", "steps", "runs",
    "cli",
)  # fmt: skip
#: Largest number of parts beside ``_dolfinx``.
MOST_PARTS = 18
#: Modules and folders with imports of the package inside functions, and why they have them.
LAZY = {
    "cli": "each command imports what it runs: the others, and --help, start at once",
    "kernels.material": "sympy generates what the cache has not; UFL and reports are asked for",
    "kernels.reports.report": "matplotlib draws a report only if asked",
    "geometry.shapes.closed_surface": "VTK takes longer to import than a small solve",
    "mesh.gmsh_model": "only files of shapes are XML",
    "mesh.mesh": "few meshes are files of XDMF",
    "linalg.ssor_cg": "small bodies are not deflated",
    "assembly.assembled_matrix": "few matrices couple nodes that share no cell",
    "runs": "a scene imports only what its tables name: contact, bones, lattices, fields",
    "contact": "a scene imports only the method of contact that it names",
    "steps.stepping": "few steps need a second solver",
    "terms": "tables are read and validated without PETSc; their terms need it",
    "scenes": "scenes are listed without sympy, which checks materials; without numpy's bones",
    "problem.problem": "few elements have a pressure field",
    "problem.definition": "bones are placed where there are some",
    "problem.goals": "sympy splits energies for those who ask for a stress",
    "studies": "pictures and gmsh are for the studies that need them",
    "viewing": "each kind of export and of page imports its own library",
}
#: Modules, and the folder of records, that any part may import, from the bottom up.
COMMON = (
    "arrays",
    "errors",
    "cache",
    "files",
    "processes",
    "choices",
    "references",
    "records",
    "_petsc",
)
#: Modules beside the folders that call the parts: module -> the highest part that it may import.
CALLERS = {
    "program_results": "accuracy",
    "nonlinear_problem": "steps",
    "dynamic_problem": "steps",
    "__main__": "cli",
}

#: Third-party packages that only these modules or parts may import.
THIRD_PARTY = {
    "dolfinx": {"_dolfinx"},
    "basix": {"_dolfinx"},
    "ffcx": {"_dolfinx"},
    "ufl": {
        "_dolfinx", "kernels.ufl_forms", "terms", "problem.goals", "problem.program_goals",
        "problem.definition", "problem.mixed.pressure_masses", "runs.output.nodal_projection",
    },
    "gmsh": {"mesh"},
    "pyvista": {"viewing"},
    "h5py": {"viewing.export"},
    "pxr": {"viewing.export"},
    "matplotlib": {"viewing"},
    "pydantic": {
        "materials.parameters", "tables", "terms", "contact.contact_tables", "contact.obstacle",
        "scenes", "studies.slurm",
    },
    "slepc4py": {"problem.modes"},
    "ipctk": {"contact.ipctk_import"},
}  # fmt: skip
_PARALLEL = {"mpi4py", "petsc4py"}
_WITHOUT_MPI = (
    "kernels", "tables", "terms.feature", "contact.contact_tables", "contact.obstacle",
    "contact.ipctk_import", "scenes", "assembly.elements", "geometry", "viewing",
)  # fmt: skip
#: Third-party packages that these parts may not import: they work without MPI and PETSc.
FORBIDDEN = dict.fromkeys(_WITHOUT_MPI, _PARALLEL) | {
    "materials": _PARALLEL | {"numpy", "cffi"},
    "errors": _PARALLEL | {"numpy"},
    "choices": _PARALLEL | {"numpy"},
}

# --- imports --------------------------------------------------------------------------------------


def module_of(path: Path) -> str:
    """Return a file's module name within the package, e.g. "terms.elastic"; "" for the package."""
    parts = path.relative_to(PACKAGE).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def part_of(path: Path) -> str:
    """Return the folder, or the module beside the folders, that a file belongs to."""
    return module_of(path).split(".")[0]


@functools.cache
def syntax_tree(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text())


@functools.cache
def imports(path: Path) -> frozenset[str]:
    """Return the full names of all that a file imports, at its top, in functions, or for types."""
    names: set[str] = set()
    for node in ast.walk(syntax_tree(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: expected absolute imports"
            module = node.module or ""
            names |= {f"{module}.{alias.name}" for alias in node.names}
    return frozenset(names)


def imported_packages(path: Path) -> set[str]:
    """Return the top-level packages that a file imports."""
    return {name.split(".")[0] for name in imports(path)}


def imported_parts(names: frozenset[str]) -> set[str]:
    """Return the parts of the package among imported names."""
    parts = {name.split(".")[1] for name in names if name.startswith("fem_snh.")}
    return parts & {*PARTS, *COMMON, *CALLERS}


def lies_in(module: str, homes: set[str]) -> bool:
    """Whether a module is one of some modules and folders, or inside one of them."""
    return any(f"{module}.".startswith(f"{home}.") for home in homes)


FILES = sorted(PACKAGE.rglob("*.py"))


def test_every_part_has_its_position():
    assert {part_of(path) for path in FILES} - {""} == {*PARTS, *COMMON, *CALLERS}


def test_the_parts_are_few():
    """A stranger reads the tree; `_dolfinx` is no part of it but the interface to its versions."""
    assert len(PARTS) - 1 <= MOST_PARTS


def test_a_class_name_has_one_meaning():
    """No public class name stands in two modules."""
    modules = defaultdict(list)
    for path in FILES:
        for node in ast.walk(syntax_tree(path)):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                modules[node.name].append(module_of(path))
    shared = {name: homes for name, homes in modules.items() if len(homes) > 1}
    assert not shared


def allowed_parts(part: str) -> set[str]:
    """Return the parts that the files of a part may import beside those of its own."""
    if part in COMMON:
        return set(COMMON[: COMMON.index(part)])
    if part in CALLERS:
        return {*COMMON, *PARTS[: PARTS.index(CALLERS[part]) + 1], *CALLERS}
    return {*COMMON, *PARTS[: PARTS.index(part)]}


def test_imports_point_down():
    """No cycle between folders: each imports those before it, lazily and for types as well."""
    upward = {}
    for path in FILES:
        part = part_of(path)
        if part:  # fem_snh/__init__.py gives the public names
            upward[path] = imported_parts(imports(path)) - {part} - allowed_parts(part)
    assert not {path: parts for path, parts in upward.items() if parts}


def lazy_imports(path: Path) -> set[str]:
    """Return the modules of the package that the functions of a file import."""
    functions = [n for n in ast.walk(syntax_tree(path)) if isinstance(n, ast.FunctionDef)]
    return {
        node.module
        for function in functions
        for node in ast.walk(function)
        if isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "fem_snh"
    }


def test_lazy_imports_have_a_reason():
    lazy = {path: lazy_imports(path) for path in FILES if not lies_in(module_of(path), set(LAZY))}
    assert not {path: modules for path, modules in lazy.items() if modules}


def code_lines(path: Path) -> int:
    """Return the number of lines of a file that are neither blank, comment nor docstring."""
    text = path.read_text()
    docstrings = set()
    for node in ast.walk(ast.parse(text)):
        body = getattr(node, "body", None)
        first = body[0] if isinstance(body, list) and body else None
        if isinstance(first, ast.Expr) and isinstance(first.value, ast.Constant):
            docstrings |= set(range(first.lineno, (first.end_lineno or 0) + 1))
    lines = {n for n, line in enumerate(text.splitlines(), 1) if line.partition("#")[0].strip()}
    return len(lines - docstrings)


@pytest.mark.parametrize(
    "caller", ["nonlinear_problem.py", "dynamic_problem.py", "runs/driver.py", "runs/setup.py"]
)
def test_callers_of_the_driver_are_thin(caller):
    """A program and a scene only translate what they are given for `fem_snh.steps`."""
    assert code_lines(PACKAGE / caller) < 150


def forbidden_packages(path: Path) -> set[str]:
    """Return the packages that a file imports and only others may, or its folder may not."""
    module, packages = module_of(path), imported_packages(path)
    elsewhere = {name for name, homes in THIRD_PARTY.items() if not lies_in(module, homes)}
    for home, names in FORBIDDEN.items():
        if lies_in(module, {home}):
            elsewhere |= names
    return packages & elsewhere


def test_third_party_packages():
    found = {path: forbidden_packages(path) for path in FILES}
    assert not {path: packages for path, packages in found.items() if packages}


def test_the_package_does_not_import_benchmarks():
    """Benchmarks and tests import the package; it is installed without them."""
    outside = {"benchmarks", "demos", "tests"}
    assert not [path for path in FILES if imported_packages(path) & outside]


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
        ("import fem_snh; fem_snh.material('neo_hookean').energy([[[1, 0, 0]] * 3])", set()),
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
