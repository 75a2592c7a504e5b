"""Factors of small matrices in two dimensions: PETSc's, which do not pivot, and those by MUMPS."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from statistics import median
from time import perf_counter

from mpi4py import MPI
from petsc4py import PETSc

from benchmarks import Row, split_list
from fem_snh import scenes
from fem_snh._petsc import set_operators
from fem_snh.linalg.direct_solver import set_direct_solver
from fem_snh.runs.setup import set_up


def rows(elements: str = "Q1,Q2", cells: str = "8,16,24,32", repeats: int = 50) -> Iterator[Row]:
    """Yield one row per element and mesh of Cook's membrane in plane strain.

    Yields
    ------
    dict
        ``unknowns``; medians of the milliseconds of factors and solution: ``petsc``, ``mumps``.
    """
    for element in split_list(elements):
        for count in map(int, split_list(cells)):
            keys = {"cells": count, "element": element, "kinematics": "plane_strain", "steps": 1}
            setup = set_up(MPI.COMM_SELF, scenes.load("cook").model_copy(update=keys))
            list(setup.stepper)
            A = setup.problem.A
            yield {
                "element": element,
                "cells": count,
                "unknowns": A.getSize()[0],
                "petsc": round(_milliseconds(A, True, repeats), 3),
                "mumps": round(_milliseconds(A, False, repeats), 3),
            }


def _milliseconds(A: PETSc.Mat, small: bool, repeats: int) -> float:
    """Return the median time of new factors of a matrix and of a solution."""
    ksp = PETSc.KSP().create(A.comm)
    set_direct_solver(ksp, small)
    b, x = A.createVecs()
    b.set(1.0)

    def solve() -> None:
        set_operators(ksp, A, A)
        ksp.solve(b, x)

    return 1e3 * median(_seconds(A, solve) for _ in range(repeats))


def _seconds(A: PETSc.Mat, solve: Callable[[], None]) -> float:
    """Return the seconds of a call after the matrix has changed, as far as PETSc knows."""
    A.shift(0.0)
    A.assemble()
    start = perf_counter()
    solve()
    return perf_counter() - start
