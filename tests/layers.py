"""The layers of docs/architecture, as `test_arrows.py` checks them: who may import whom."""

from __future__ import annotations

#: From the bottom up. A part imports parts of lower layers only, none of its own layer. A part is a
#: folder or a file of the package; each file of ``fem`` is a part.
LAYERS: tuple[tuple[str, ...], ...] = (
    ("errors", "choices", "output_fields", "fem.timing"),
    ("atomic_files", "references"),
    ("_petsc", "materials", "fem.elements"),
    ("_dolfinx",),
    ("kernels", "fem.gmsh_input"),
    ("linalg",),
    ("fem.mesh", "fem.numbering", "fem.block_sparsity", "fem.near_null_space"),
    ("scenes", "fem.ufl_frame", "fem.matrix_layout", "fem.regions", "fem.boundary_conditions"),
    ("fem.ufl_stretches",),
    ("fem.ufl_forms", "fem.assembled_matrix", "fem.element_tables"),
    ("fem.terms", "fem.unknowns", "fem.rank_one"),
    ("fem.taylor_hood", "fem.measures"),
    ("fem.problem",),
    ("fem.create_problem", "fem.probes", "fem.initial_state", "fem.nodal_projection"),
    ("fem.dolfinx_problem", "fem.stress_fields"),
    ("fem.field_values", "fem.eigenproblem"),
    ("fem.modes",),
    ("solver",),
    ("runs", "nonlinear_problem"),
    ("plots", "render", "doctor"),
    ("view", "export"),
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
    "fem.rank_one": {"_dolfinx"},
    "fem.measures": {"_dolfinx", "fem.mesh", "fem.boundary_conditions"},
    "fem.eigenproblem": {"errors", "fem.regions", "fem.terms", "fem.problem"},
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
    "export": {"errors", "atomic_files", "render"},
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
    "pyvista": {"render", "view", "export"},
    "h5py": {"export"},
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
