"""Vectors, matrices and UFL forms."""

from __future__ import annotations

from collections.abc import Sequence
from inspect import signature
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from dolfinx.fem import petsc as fem_petsc

from fem_snh._dolfinx.common import _quiet


def petsc_vec(u: Any) -> PETSc.Vec:
    """The ghosted PETSc vector that shares u's memory."""
    return u.x.petsc_vec if hasattr(u.x, "petsc_vec") else u.vector


def create_vector(V: Any) -> PETSc.Vec:
    """A new ghosted vector on V, with V's block size."""
    index_map, bs = V.dofmap.index_map, V.dofmap.index_map_bs
    size = (index_map.size_local * bs, index_map.size_global * bs)
    ghosts = np.asarray(index_map.ghosts, dtype=PETSc.IntType)
    vector = PETSc.Vec().createGhost(ghosts, size, bsize=bs, comm=V.mesh.comm)
    vector.set(0.0)
    return vector


def _jit(function: Any, options: dict | None) -> dict:
    """JIT options under the name that this version of `function` knows (params in 0.5)."""
    if not options:
        return {}
    name = "jit_options" if "jit_options" in signature(function).parameters else "jit_params"
    return {name: options}


def form(ufl_form: Any, jit_options: dict | None = None) -> Any:
    """Compile a UFL form, e.g. with {"cffi_extra_compile_args": ["-O3", "-march=native"]}."""
    with _quiet():
        return fem.form(ufl_form, **_jit(fem.form, jit_options))


def interpolate(u: Any, expression: Any, jit_options: dict | None = None) -> None:
    """Put a UFL expression into the function u, at its element's interpolation points."""
    points = u.function_space.element.interpolation_points
    points = points() if callable(points) else points  # a method up to 0.9
    with _quiet():
        options = _jit(fem.Expression.__init__, jit_options)
        u.interpolate(fem.Expression(expression, points, **options))
    u.x.scatter_forward()


def assemble_scalar(compiled: Any) -> float:
    """The integral over all ranks. Collective."""
    domain = compiled.mesh
    return float(domain.comm.allreduce(fem.assemble_scalar(compiled), op=MPI.SUM))


def assemble_vector(vector: PETSc.Vec, compiled: Any) -> None:
    """Overwrite a ghosted vector by a linear form, summed over the ranks; ghosts are updated."""
    with vector.localForm() as local:
        local.set(0.0)
    fem_petsc.assemble_vector(vector, compiled)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)


def create_matrix(compiled: Any) -> PETSc.Mat:
    """An AIJ matrix (V's block size) with the pattern of a bilinear form."""
    return fem_petsc.create_matrix(compiled)


def assemble_matrix(matrix: PETSc.Mat, compiled: Any, bcs: Sequence[Any] = ()) -> None:
    """Overwrite a matrix by a bilinear form; rows and columns of bcs are 1 on the diagonal."""
    matrix.zeroEntries()
    assemble: Any = getattr(fem_petsc, "assemble_matrix_mat", fem_petsc.assemble_matrix)
    assemble(matrix, compiled, list(bcs))
    matrix.assemble()
