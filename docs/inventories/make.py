"""Write the inventories of other projects' pages that this site's pages link to.

    python docs/inventories/make.py

`NAMES` lists what is cited, as each project's own objects.inv has it. Sphinx reads these files in
place of those, so that the site is built without a network, and everywhere with the same links.
Needs sphobjinv, which the `docs` extra does not bring.
"""

from __future__ import annotations

from pathlib import Path

from sphobjinv import DataObjStr, Inventory, compress, writebytes

#: Of each project: role, page, names. "$" is Sphinx's abbreviation of the name itself.
NAMES: dict[str, list[tuple[str, str, tuple[str, ...]]]] = {
    "python": [
        ("py:class", "library/pathlib.html#$", ("pathlib.Path",)),
        ("py:module", "library/tomllib.html#module-$", ("tomllib",)),
    ],
    "numpy": [
        ("py:class", "reference/generated/numpy.ndarray.html#$", ("numpy.ndarray",)),
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
            "petsc4py.PETSc.Viewer",
        )),
    ],
    "mpi4py": [
        ("py:class", "reference/$.html", ("mpi4py.MPI.Comm", "mpi4py.MPI.Intracomm")),
    ],
}  # fmt: skip


def write(project: str, folder: Path) -> None:
    """Write the inventory of one project."""
    inventory = Inventory()
    inventory.project, inventory.version = project, ""
    for role, uri, names in NAMES[project]:
        domain, kind = role.split(":")
        for name in names:
            shown = name.rpartition("/")[2] if "/" in name else "-"
            entry = DataObjStr(
                name=name, domain=domain, role=kind, priority="1", uri=uri, dispname=shown
            )
            inventory.objects.append(entry)
    writebytes(str(folder / f"{project}.inv"), compress(inventory.data_file()))


if __name__ == "__main__":
    for project in NAMES:
        write(project, Path(__file__).parent)
