"""Matrix blocks between nodes that share no cell, against dense sums and solves."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import Hold, cube, dense, problem

from fem_snh import _dolfinx
from fem_snh._petsc import nonzero_state
from fem_snh.linalg.ssor_cg import EisenstatCG
from fem_snh.problem.problem import Problem

pytestmark = pytest.mark.mpi


def make(element: str, components: tuple[str, ...] = ("x", "z")) -> Problem:
    """Return a problem of a cube with one fixed side."""
    body = cube(MPI.COMM_WORLD, "tetrahedron" if element[0] == "P" else "hexahedron")
    return problem(body, element, hold=[Hold("left", components)])


def random_springs(p: Problem, seed: int, count: int = 5, k: int = 4) -> tuple[Any, Any]:
    """Return random groups of nodes, the same on every rank, with semidefinite matrices."""
    rng = np.random.default_rng(seed)
    total = p.comm.allreduce(_dolfinx.num_nodes(p.V)[0])
    nodes = np.stack([rng.permutation(total)[:k] for _ in range(count)])
    factors = rng.standard_normal((count, 3 * k, 2))
    return nodes, factors @ factors.transpose(0, 2, 1)


def pairs(nodes: np.ndarray) -> np.ndarray:
    """Return all pairs of nodes of each group."""
    k = nodes.shape[1]
    return np.stack([np.repeat(nodes, k, axis=1), np.tile(nodes, (1, k))], axis=2).reshape(-1, 2)


def dense_sum(p: Problem, nodes: np.ndarray, matrices: np.ndarray) -> np.ndarray:
    """Return the sum of the matrices without constrained rows and columns."""
    total = np.zeros(2 * p.A.getSize()[:1])
    blocks = p.matrix._dof_map.displacement_blocks(nodes)
    for group, matrix in zip(blocks, matrices, strict=True):
        dofs = (p.matrix._dof_map.global_dofs(group)[0][:, None] + np.arange(3)).ravel()
        total[np.ix_(dofs, dofs)] += matrix
    fixed = np.concatenate(p.comm.allgather(p.constrained_dofs + p.A.getOwnershipRange()[0]))
    total[fixed] = total[:, fixed] = 0.0
    return total


def assemble(p: Problem, nodes: np.ndarray | None = None, matrices: Any = None) -> np.ndarray:
    """Assemble the elastic Hessian at rest, with further matrices."""
    u, pressure = p.split(p.x)
    with p.matrix.adding():
        p.elastic.add_hessian(u, pressure, "clamp", p.matrix)
        if nodes is not None:
            p.matrix.add_couplings(nodes, matrices)
    return dense(p.A)


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_matrices_of_distant_nodes_are_summed(element: str) -> None:
    """Each rank gives all groups of nodes; the pattern grows, shrinks and keeps its object."""
    p = make(element)
    handle, alone = p.A.handle, assemble(p)
    states = [nonzero_state(p.A)]
    for seed in (1, 2, 2, 3):
        nodes, matrices = random_springs(p, seed)
        p.matrix.couple([pairs(nodes)])
        found = assemble(p, nodes, matrices)
        scale = np.abs(found).max()
        expected = alone + dense_sum(p, nodes, matrices)
        np.testing.assert_allclose(found, expected, atol=1e-13 * scale)
        np.testing.assert_allclose(assemble(p), alone, atol=1e-13 * scale)
        states.append(nonzero_state(p.A))
    assert p.A.handle == handle and p.A == p.matrix.mat
    assert states[2] == states[3] and len(set(states)) == 4


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("preconditioner", ["own", "bjacobi"])
def test_linear_solvers_follow_the_pattern(preconditioner: str) -> None:
    """Conjugate gradients with SSOR, and GMRES with incomplete factors.

    The pattern grows, grows and shrinks: a single new pair replaces many old ones.
    """
    p = make("Q1", ("x", "y", "z"))
    ksp = PETSc.KSP().create(p.comm)
    ksp.setTolerances(rtol=1e-9, max_it=500)
    if preconditioner == "own":
        ksp.setType(PETSc.KSP.Type.PYTHON)
        ksp.setPythonContext(EisenstatCG(p.coordinates))
        ksp.getPC().setType(PETSc.PC.Type.NONE)
    else:
        ksp.setType(PETSc.KSP.Type.GMRES)
        ksp.getPC().setType(PETSc.PC.Type.BJACOBI)
    b, x, Ax = (p.x.duplicate() for _ in range(3))
    b.array[:] = np.random.default_rng(p.comm.rank).standard_normal(b.getLocalSize())
    b.array[p.constrained_dofs] = 0.0
    entries = []
    for seed, count, k in ((None, 0, 0), (1, 5, 4), (2, 5, 4), (3, 1, 2)):
        if seed is None:
            assemble(p)
        else:
            nodes, matrices = random_springs(p, seed, count, k)
            p.matrix.couple([pairs(nodes)])
            assemble(p, nodes, 0.1 * matrices)
        entries.append(p.A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"])
        ksp.setOperators(p.operator, p.A)
        ksp.solve(b, x)
        assert ksp.getConvergedReason() > 0
        p.A.mult(x, Ax)
        assert (Ax - b).norm() < 1e-6 * b.norm()
    assert entries[0] < entries[3] < entries[1] < entries[2]
