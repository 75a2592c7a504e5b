"""Compile UFL forms; create and assemble vectors and matrices."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from inspect import signature
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
from dolfinx import fem
from dolfinx.fem import FunctionSpace
from dolfinx.fem import petsc as fem_petsc

from fem_snh.cache import compiling


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress messages about compiling a form, on which no user can act.

    These are log records of level INFO (dolfinx 0.5) and the warning that a quadrature rule has
    many points: the program chooses the degrees.
    """
    before = logging.root.manager.disable
    logging.disable(max(before, logging.INFO))
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Number of integration points per cell")
            yield
    finally:
        logging.disable(before)


def petsc_vec(u: fem.Function) -> PETSc.Vec:
    """Return the ghosted PETSc vector that shares the memory of the function ``u``."""
    # 0.5 has u.vector, 0.9 and 0.11 have u.x.petsc_vec
    return u.x.petsc_vec if hasattr(u.x, "petsc_vec") else u.vector


def create_vector(V: FunctionSpace) -> PETSc.Vec:
    """Return a ghosted vector of zeros on V, with V's block size. Collective."""
    index_map, bs = V.dofmap.index_map, V.dofmap.index_map_bs
    size = (index_map.size_local * bs, index_map.size_global * bs)
    ghosts = np.asarray(index_map.ghosts, dtype=PETSc.IntType)
    vector = PETSc.Vec().createGhost(ghosts, size, bsize=bs, comm=V.mesh.comm)
    with vector.localForm() as local:
        local.set(0.0)
    return vector


def _jit(function: Any, options: dict | None) -> dict:
    """Return JIT options as the keyword argument of ``function``; {} without options."""
    if not options:
        return {}
    # jit_params in 0.5, jit_options in 0.9 and 0.11
    name = "jit_options" if "jit_options" in signature(function).parameters else "jit_params"
    return {name: options}


def form(ufl_form: Any, jit_options: dict | None = None) -> Any:
    """Compile a UFL form; return the dolfinx form. Collective.

    Parameters
    ----------
    ufl_form : ufl.Form
        The form.
    jit_options : dict, optional
        FFCx's options, e.g. {"cffi_extra_compile_args": ["-O3", "-march=native"]}.
    """
    with _quiet(), compiling():
        return fem.form(ufl_form, **_jit(fem.form, jit_options))


def interpolate(u: fem.Function, expression: Any) -> None:
    """Interpolate a UFL expression into the function ``u``, ghosts included. Collective."""
    points = u.function_space.element.interpolation_points
    points = points() if callable(points) else points  # a method up to 0.9, a property since 0.10
    with _quiet():
        with compiling():
            compiled = fem.Expression(expression, points)
        u.interpolate(compiled)
    u.x.scatter_forward()


def assemble_scalar(compiled: Any) -> float:
    """Return a compiled form's integral, summed over all ranks. Collective."""
    domain = compiled.mesh
    return float(domain.comm.allreduce(fem.assemble_scalar(compiled), op=MPI.SUM))


def assemble_vector(vector: PETSc.Vec, compiled: Any) -> None:
    """Overwrite a ghosted vector with an assembled linear form, and update ghosts. Collective."""
    with vector.localForm() as local:
        local.set(0.0)
    fem_petsc.assemble_vector(vector, compiled)
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
    vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)


def add_vector(vector: PETSc.Vec, compiled: Any) -> None:
    """Add this rank's part of a linear form to a ghosted vector, without ghost updates."""
    fem_petsc.assemble_vector(vector, compiled)


def create_matrix(compiled: Any) -> PETSc.Mat:
    """Return an AIJ matrix with the sparsity pattern of a bilinear form. Collective."""
    return fem_petsc.create_matrix(compiled)


def assemble_matrix(matrix: PETSc.Mat, compiled: Any) -> None:
    """Overwrite a matrix with an assembled bilinear form. Collective."""
    matrix.zeroEntries()
    # 0.9 names the overload for an existing matrix; 0.5 has assemble_matrix alone
    assemble: Any = getattr(fem_petsc, "assemble_matrix_mat", fem_petsc.assemble_matrix)
    assemble(matrix, compiled)
    matrix.assemble()
