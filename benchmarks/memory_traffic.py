"""Time of each part of a Newton iteration, and the lower bound from its memory traffic."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from time import perf_counter
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from benchmarks import Row
from fem_snh import scenes, solver
from fem_snh.assembly.elements import element as element_of
from fem_snh.assembly.regions import Filling
from fem_snh.kernels.material import material
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.problem.definition import Definition
from fem_snh.problem.problem import Problem
from fem_snh.runs import make_mesh

#: Numbers in the copy that measures the bandwidth: more than any cache holds.
_COPIED = 20_000_000
#: Krylov iterations that are timed together: fewer than any solver here needs.
_STEPS = 10


def rows(cells: int = 38, nu: float = 0.49, repeat: int = 5) -> Iterator[Row]:
    """Yield a row for the bandwidth of the memory, and one per part of a Newton iteration.

    The problem is the stretch. All ranks work at the same time; a time is the best of ``repeat``,
    each that of the slowest rank.

    Yields
    ------
    dict
        ``bytes_per_cell``: least memory traffic, each value moved once; ``limit_ms``: its time at
        the bandwidth of a copy in this run; ``share``: limit_ms over ms.
    """
    comm = MPI.COMM_WORLD
    speed = _bandwidth(comm, repeat)
    yield {"part": "copy", "ranks": comm.size, "GB_per_s": round(speed / 1e9, 2)}
    p = _stretched(comm, cells, nu)
    for name, call, moved in _parts(p):
        took, most = _best(comm, call, repeat), comm.allreduce(moved)
        yield {
            "part": name,
            "ranks": comm.size,
            "dofs": p.dofs,
            "ms": round(1e3 * took, 3),
            "us_per_cell": round(1e6 * took * comm.size / p.num_cells, 3),
            "bytes_per_cell": round(most / p.num_cells),
            "limit_ms": round(1e3 * most / speed, 3),
            "share": round(most / speed / took, 3),
        }


def _best(comm: MPI.Comm, call: Callable[[], Any], repeat: int) -> float:
    """Return the best of ``repeat`` times [s], each that of the slowest rank."""
    best = float("inf")
    for _ in range(repeat + 1):  # the first one warms up
        comm.barrier()
        start = perf_counter()
        call()
        best = min(best, comm.allreduce(perf_counter() - start, op=MPI.MAX))
    return best


def _bandwidth(comm: MPI.Comm, repeat: int) -> float:
    """Return the bytes per second that all ranks together read and write in a copy."""
    source, target = np.ones(_COPIED), np.zeros(_COPIED)
    seconds = _best(comm, lambda: np.copyto(target, source), repeat)
    return comm.size * 2 * source.nbytes / seconds


def _stretched(comm: MPI.Comm, cells: int, nu: float) -> Problem:
    """Return the stretch after the predictor of a step: filtered points and a residual."""
    scene = scenes.load("stretch", cells=cells, nu=nu)
    element = element_of(scene.element)
    snh = material("stable_neo_hookean", E=1.0, nu=nu)
    p = Definition(
        make_mesh(comm, scene), element, [Filling(snh)], [*scene.hold, *scene.move]
    ).problem()
    solver.Predictor(p, solver.create(p, globalization="linesearch"), "tangent").predict(1 / 12)
    return p


def _parts(p: Problem) -> Iterator[tuple[str, Callable[[], Any], float]]:
    """Yield the name of each part, a call, and the bytes that this rank must move."""
    r, d = p.x.duplicate(), p.x.duplicate()
    nodes, shape = p.x.getLocalSize() / 3, p.elastic.shape
    # Read: the node numbers of the cells (displacement and geometry), u and x.
    read = 2 * 4 * shape[0] * shape[1] + 2 * 24 * nodes
    yield "energy", lambda: p.energy(p.x), read
    yield "residual", lambda: p.residual(p.x, r), read + 2 * 24 * nodes
    values = sum(p.matrix.layout.num_values)
    # The positions of the blocks; half of the values as pairs of floats, read and written.
    fill = read + 4 * shape[0] * shape[1] ** 2 + 8 * values
    yield "jacobian, exact", lambda: p.jacobian(p.x, "exact"), fill
    yield "jacobian, clamp", lambda: p.jacobian(p.x, "clamp"), fill
    for name, coordinates in (("CG + SSOR", None), ("ours, deflated", p.coordinates)):
        ksp, ours = _ksp(p, "python", "none"), EisenstatCG(coordinates)
        ksp.setPythonContext(ours)
        ksp.solve(r, d)
        kept = _bytes_read_twice(ours)
        yield f"{name}, set-up", partial(_update_again, ours, p.P), 4 * values
        # Half of the matrix, twice, and 20 vectors in single precision.
        yield f"{_STEPS} {name}", partial(ksp.solve, r, d), _STEPS * (2 * kept + 240 * nodes)
    # AIJ: a value and a column per entry. CG with Jacobi: 12 vectors besides those of the product.
    yield "product, AIJ", lambda: p.A.mult(r, d), 12 * values + 2 * 24 * nodes
    jacobi = _ksp(p, "cg", "jacobi")
    yield f"{_STEPS} CG + Jacobi", lambda: jacobi.solve(r, d), _STEPS * (12 * values + 336 * nodes)


def _bytes_read_twice(ours: EisenstatCG) -> int:
    """Return the bytes on this rank that an iteration reads twice: the half of A, and A Z."""
    system = ours._system
    stored = system.matrix.arrays
    arrays = [stored[name] for name in stored if "_rest" not in name and name != "own_diagonal"]
    if system.deflation:
        read = "image", "pair_start", "pair_subdomain"
        arrays += [system.deflation.arrays[name] for name in read]
    return sum(array.nbytes for array in arrays)


def _update_again(ours: EisenstatCG, A: PETSc.Mat) -> None:
    """Set up again for a matrix that has not changed."""
    ours._state = -1
    ours.update_matrix(A)


def _ksp(p: Problem, kind: str, preconditioner: str) -> PETSc.KSP:
    """Return a solver that takes exactly `_STEPS` iterations."""
    ksp = PETSc.KSP().create(p.comm)
    ksp.setOperators(p.P if kind == "python" else p.A)
    ksp.setType(kind)
    ksp.getPC().setType(preconditioner)
    ksp.setTolerances(rtol=1e-30, atol=0.0, max_it=_STEPS)
    return ksp
