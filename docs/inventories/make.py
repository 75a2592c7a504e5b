"""Write the inventories of other projects' pages that this site's pages link to.

    python docs/inventories/make.py

`NAMES` lists what is cited, as each project's own objects.inv has it in the version that conf.py
names. Sphinx reads these files in place of those, so that the site is built without a network, and
everywhere with the same links.
"""

from __future__ import annotations

import zlib
from pathlib import Path

#: Of each project: role, page, names. "$" in a page stands for the name.
NAMES: dict[str, list[tuple[str, str, tuple[str, ...]]]] = {
    "python": [
        ("py:class", "library/pathlib.html#$", ("pathlib.Path",)),
        ("py:module", "library/tomllib.html#module-$", ("tomllib",)),
        ("py:class", "library/collections.abc.html#$", (
            "collections.abc.Callable", "collections.abc.Iterable", "collections.abc.Iterator",
            "collections.abc.Mapping", "collections.abc.Sequence",
        )),
    ],
    "numpy": [
        ("py:class", "reference/generated/$.html#$", ("numpy.ndarray", "numpy.dtype")),
        ("py:class", "reference/arrays.scalars.html#$", (
            "numpy.float64", "numpy.int32", "numpy.bool_",
        )),
        ("py:class", "reference/typing.html#$", ("numpy.typing.NDArray", "numpy.typing.ArrayLike")),
    ],
    "dolfinx": [
        ("py:class", "generated/dolfinx.fem.html#$", ("dolfinx.fem.Function",)),
        ("py:class", "generated/dolfinx.mesh.html#$", (
            "dolfinx.mesh.Mesh", "dolfinx.mesh.MeshTags",
        )),
        ("py:module", "generated/dolfinx.io.gmshio.html#module-$", ("dolfinx.io.gmshio",)),
    ],
    "ufl": [
        ("py:class", "api-doc/ufl.core.html#$", ("ufl.core.expr.Expr",)),
        ("py:function", "api-doc/ufl.html#ufl.operators.variable", ("ufl.variable",)),
        ("py:function", "api-doc/ufl.html#ufl.formoperators.derivative", ("ufl.derivative",)),
    ],
    "petsc": [
        ("std:doc", "$/", (
            "manual/snes", "manual/ksp", "manualpages/SNES/SNESNEWTONTR",
            "manualpages/KSP/KSPCG", "manualpages/KSP/KSPSTCG", "manualpages/PC/PCEISENSTAT",
            "manualpages/PC/PCDEFLATION", "manualpages/PC/PCFIELDSPLIT",
            "manualpages/Mat/MatSetValuesCOO",
        )),
    ],
    "petsc4py": [
        ("py:class", "reference/$.html", (
            "petsc4py.PETSc.SNES", "petsc4py.PETSc.KSP", "petsc4py.PETSc.PC", "petsc4py.PETSc.Mat",
            "petsc4py.PETSc.Vec", "petsc4py.PETSc.Options", "petsc4py.PETSc.Error",
            "petsc4py.PETSc.Viewer", "petsc4py.PETSc.IS", "petsc4py.PETSc.NullSpace",
        )),
    ],
    "pandas": [
        ("py:class", "reference/api/pandas.DataFrame.html#pandas.DataFrame", (
            "pandas.DataFrame", "pandas.core.frame.DataFrame",
        )),
    ],
    "sympy": [
        ("py:class", "modules/core.html#$", ("sympy.core.expr.Expr", "sympy.core.symbol.Symbol")),
        ("py:function", "modules/utilities/lambdify.html#sympy.utilities.lambdify.lambdify", (
            "sympy.lambdify",
        )),
    ],
    "mpi4py": [
        ("py:class", "reference/$.html", ("mpi4py.MPI.Comm", "mpi4py.MPI.Intracomm")),
    ],
}  # fmt: skip


def write(project: str, folder: Path) -> None:
    """Write the inventory of one project, in version 2 of Sphinx's format."""
    head = f"# Sphinx inventory version 2\n# Project: {project}\n# Version: \n"
    head += "# The remainder of this file is compressed using zlib.\n"
    lines = []
    for role, uri, names in NAMES[project]:
        for name in names:
            shown = name.rpartition("/")[2] if "/" in name else "-"
            lines.append(f"{name} {role} 1 {uri.replace('$', name)} {shown}\n")
    text = head.encode() + zlib.compress("".join(lines).encode(), 9)
    (folder / f"{project}.inv").write_bytes(text)


if __name__ == "__main__":
    for project in NAMES:
        write(project, Path(__file__).parent)
