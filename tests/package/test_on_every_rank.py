"""Errors of one rank are raised on all; what each update needs of MPI is made once."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
from bodies import cube, problem

from fem_snh.assembly import matrix_layout
from fem_snh.errors import BadInput
from fem_snh.linalg import block_matrix as halo
from fem_snh.linalg.ssor_cg import SSORSystem

pytestmark = pytest.mark.mpi


def test_a_layout_that_is_too_large_on_one_rank(comm, monkeypatch):
    """All ranks raise, and the next collective call finds them all."""
    if comm.rank == comm.size - 1:
        monkeypatch.setattr(matrix_layout, "_LARGEST", 100)
    with pytest.raises(BadInput, match="too many unknowns for one rank"):
        assert problem(cube(comm, "hexahedron"), "Q1").matrix
    assert comm.allreduce(1) == comm.size


def test_a_matrix_without_a_diagonal_block_on_one_rank(comm):
    A = PETSc.Mat().createAIJ(((6, None), (6, None)), bsize=3, nnz=(6, 6), comm=comm)
    first, last = A.getOwnershipRange()
    rows = np.arange(first, last - 3 if comm.rank == comm.size - 1 else last, dtype=np.int32)
    for row in rows:
        A.setValue(row, row, 1.0)
    A.setOption(PETSc.Mat.Option.NO_OFF_PROC_ENTRIES, True)
    A.assemble()
    with pytest.raises(BadInput, match="a matrix with a diagonal block in every row"):
        SSORSystem(A, None)
    assert comm.allreduce(1) == comm.size


@pytest.mark.one_debian("ranks")
def test_an_exchange_of_a_nodes_values(comm):
    """Each rank receives the next rank's numbers; the MPI types are shared."""
    size, width = 3, 2
    first = size * np.arange(comm.size + 1)
    other = (comm.rank + 1) % comm.size
    nodes = first[other] + np.arange(size) if comm.size > 1 else np.empty(0, int)
    made = halo._node_type.cache_info().misses
    for _ in range(10):
        exchange = halo.Halo(comm, first, nodes, width, np.float64)
        values = np.arange(width * size) + 10.0 * comm.rank
        exchange.exchange(values)
        expected = (np.arange(width * size) + 10.0 * other)[: width * len(nodes)]
        np.testing.assert_array_equal(exchange.ghosts.ravel(), expected)
    assert halo._node_type.cache_info().misses <= made + 1
