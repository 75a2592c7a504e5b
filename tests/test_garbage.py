"""Problems that are no longer used leave no PETSc objects behind."""

from __future__ import annotations

import resource
from pathlib import Path
from weakref import ref

import pytest
import ufl
from bodies import cube

import fem_snh
from fem_snh import _dolfinx
from fem_snh.runs import run
from fem_snh.solver import garbage

mpi = pytest.mark.mpi


def resident(comm):
    """Return the resident memory of all ranks [MB]."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return comm.allreduce(pages * resource.getpagesize() / 2**20)


def linked(problems):
    """Return which of the problems are still in memory."""
    return [problem() is not None for problem in problems]


@mpi
def test_repeated_runs_take_no_more_memory(comm):
    """The objects of such a run take 30 MB."""
    problems, memory = [], []
    for _ in range(5):
        result = run("stretch", element="Q2Q1", cells=6, steps=1, stretch=1.1, progress=False)
        problems.append(ref(result.problem))
        del result
        memory.append(resident(comm))
    assert not any(linked(problems))
    assert memory[-1] - memory[1] < 30


@mpi
def test_the_solver_of_a_problem_in_a_program_is_freed(comm):
    """Its SNES refers to the problem, and is freed when the next solver is created."""
    problems = []
    for _ in range(3):
        V = _dolfinx.function_space(cube(comm, "hexahedron").domain, 1, (3,))
        material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)
        problem = fem_snh.NonlinearProblem(_dolfinx.function(V, "u"), {material: ufl.dx})
        problems.append(ref(problem._problem))
        del problem
    garbage.free_unused(comm)
    assert not any(linked(problems))
