"""Problems that are no longer used leave no PETSc objects behind."""

from __future__ import annotations

import ctypes
import gc
import re
import subprocess
import sys

from petsc4py import PETSc

import pytest
import ufl
from bodies import cube
from paths import SUPPORT

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.studies.tasks import environment

mpi = pytest.mark.mpi


def allocated(comm):
    """Return the memory of all ranks that malloc has given out [bytes].

    Resident memory also has what was freed and is not used again yet.
    """
    libc = ctypes.CDLL(None)
    names = "arena ordblks smblks hblks hblkhd usmblks fsmblks uordblks fordblks keepcost"
    fields = [(name, ctypes.c_size_t) for name in names.split()]
    libc.mallinfo2.restype = type("mallinfo2", (ctypes.Structure,), {"_fields_": fields})
    found = libc.mallinfo2()
    return comm.allreduce(found.uordblks + found.hblkhd)


def solved(comm, kind, element, cells):
    """Solve a program's problem, or a step of a motion; return the bytes of its matrix."""
    body = cube(comm, ELEMENTS[element].cell, cells)
    V = _dolfinx.function_space(body.domain, ELEMENTS[element].degree, (3,))
    u = _dolfinx.function(V, "u")
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.4)
    terms = [1e-3 * ufl.inner(u, u) * ufl.ds, ufl.inner(ufl.as_vector((0, 0, 1e-3)), u) * ufl.dx]
    arguments = {"terms": terms, "element": element}
    if element == "Q1" and kind == "static":  # without a term there is no reference cycle
        arguments["terms"] = []
        u.interpolate(lambda x: 0.1 * x)
    if kind == "static":
        problem = fem_snh.NonlinearProblem(u, {material: ufl.dx}, **arguments)
        problem.solve()
        assert problem.solver.getConvergedReason() > 0
    else:
        densities = {material: 1.0}
        problem = fem_snh.DynamicProblem(
            u, {material: ufl.dx}, densities, duration=1.0, damping=(0.1, 0.1), **arguments
        )
        assert problem.step(0.1)
    return 12 * problem.A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize(
    ("kind", "element", "cells"),
    [pytest.param("static", "Q1", 10, marks=mpi), ("static", "P2P1", 4), ("motion", "Q1", 10)],
)
def test_repeated_programs_take_no_more_memory(comm, kind, element, cells):
    """What six more instances leave is less than a tenth of one matrix for each.

    PETSc loses objects that are dropped while it frees others: see `fem_snh.solver.errors`.
    """
    memory = []
    for _ in range(9):
        size = solved(comm, kind, element, cells)
        gc.collect()
        memory.append(allocated(comm))
    assert memory[-1] - memory[2] < 0.1 * 6 * size


#: Estimates errors as often as its argument says, on the cells of one element.
ESTIMATES = """
import gc, sys
sys.path.insert(0, {tests!r})
from bodies import cube
from mpi4py import MPI
import fem_snh, ufl
from fem_snh import _dolfinx

body = cube(MPI.COMM_WORLD, "tetrahedron", 1)
u = _dolfinx.function(_dolfinx.function_space(body.domain, 2, (3,)), "u")
material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3)
terms = [1e-2 * ufl.inner(u, u) * ufl.ds, 1e-3 * u[2] * ufl.ds]
problem = fem_snh.NonlinearProblem(u, {{material: ufl.dx}}, terms=terms, element={element!r})
problem.solve()
for _ in range(int(sys.argv[1])):
    problem.estimate_error({{"energy": "energy"}})
    gc.collect()
"""


def remaining(log):
    """Return how many more objects of each class were created than destroyed, by PETSc's log."""
    table = log[log.index("Object Type") :].split("=====")[0]
    rows = re.findall(r"^\s+(\S.*?)\s+(\d+)\s+(\d+)$", table, re.MULTILINE)
    return {name: int(created) - int(destroyed) for name, created, destroyed in rows}


@pytest.mark.parametrize("element", ["P2P0", "P2P1"])
def test_estimates_leave_no_objects(tmp_path, element):
    """Vectors of mixed spaces have communicators of their own: four vectors a call remained."""
    script = tmp_path / "estimates.py"
    script.write_text(ESTIMATES.format(tests=str(SUPPORT), element=element))
    counts = []
    for times in ("1", "3"):
        log = tmp_path / f"log{times}"
        options = environment() | {"PETSC_OPTIONS": f"-log_view :{log}"}
        subprocess.run([sys.executable, script, times], env=options, check=True, timeout=120)
        counts.append(remaining(log.read_text()))
    assert counts[0]["Vector"] > 0
    assert counts[0] == counts[1]
