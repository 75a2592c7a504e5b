"""The parts of the package from the bottom up, and who may import which other packages."""

from __future__ import annotations

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
    "linalg.ssor_cg": "small bodies are not deflated",
    "runs": "a scene imports only what its tables name: contact, bones, lattices, fields",
    "contact": "a scene imports only the method of contact that it names",
    "steps.stepping": "few steps need a second solver",
    "terms": "tables are read and validated without PETSc; their terms need it",
    "scenes": "scenes are listed without sympy, which checks materials; without numpy's bones",
    "problem.definition": "bones are placed where there are some",
    "accuracy.goals": "sympy splits energies for those who ask for a stress",
    "studies": "pictures and gmsh are for the studies that need them",
    "viewing": "each kind of export and of page imports its own library",
}
#: Modules, and the folder of records, that any part may import, from the bottom up.
COMMON = ("errors", "cache", "files", "processes", "choices", "references", "records", "_petsc")
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
        "_dolfinx", "kernels.ufl_forms", "terms", "accuracy.goals", "accuracy.program_goals",
        "problem.definition", "problem.mixed.pressure_masses", "runs.output.nodal_projection",
    },
    "gmsh": {"mesh"},
    "pyvista": {"viewing"},
    "h5py": {"viewing.export"},
    "pxr": {"viewing.export"},
    "matplotlib": {"viewing"},
    "pydantic": {
        "materials.parameters", "tables", "terms", "contact.contact", "contact.obstacle", "scenes",
        "studies.slurm",
    },
    "slepc4py": {"problem.modes"},
    "ipctk": {"contact.barrier"},
}  # fmt: skip
_PARALLEL = {"mpi4py", "petsc4py"}
_WITHOUT_MPI = (
    "kernels", "tables", "terms.feature", "contact.contact", "contact.obstacle", "scenes",
    "assembly.elements", "geometry", "viewing",
)  # fmt: skip
#: Third-party packages that these parts may not import: they work without MPI and PETSc.
FORBIDDEN = dict.fromkeys(_WITHOUT_MPI, _PARALLEL) | {
    "materials": _PARALLEL | {"numpy", "cffi"},
    "errors": _PARALLEL | {"numpy"},
    "choices": _PARALLEL | {"numpy"},
}
