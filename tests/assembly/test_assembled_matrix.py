"""Element matrices that terms add to the common matrix, against a dense sum."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Hold, cube, dense, problem

from fem_snh.assembly.matrix_layout import MatrixLayout

pytestmark = pytest.mark.mpi


@pytest.mark.one_debian
@pytest.mark.parametrize("leading", [False, True], ids=["all dofs", "displacement"])
@pytest.mark.parametrize(
    ("element", "half"), [("Q1", False), ("P2P1", False), ("Q1", True)], ids=["Q1", "P2P1", "half"]
)
def test_element_matrices_are_summed(element: str, half: bool, leading: bool) -> None:
    """In batches, some cells twice; constrained rows and columns are left out."""
    comm = MPI.COMM_WORLD
    p = problem(cube(comm, "tetrahedron" if element[0] == "P" else "hexahedron"), element,
                hold=[Hold("left", ("x", "z"))])  # fmt: skip
    if half:
        p.store_half()
    dof_map = p.matrix._dof_map
    nodes = dof_map.num_cell_blocks[0] if leading else sum(dof_map.num_cell_blocks)
    sizes = dof_map.cell_block_sizes[:nodes]
    cells = np.concatenate([np.arange(len(dof_map.cell_blocks)), [0, 0]]).astype(np.int32)
    K = np.random.default_rng(comm.rank).standard_normal((len(cells), sizes.sum(), sizes.sum()))
    if half:
        K += K.transpose(0, 2, 1)
    with p.matrix.adding():
        for batch in np.array_split(np.arange(len(cells)), 3 + comm.rank):
            p.matrix.add_matrices(cells[batch], K[batch])

    expected = np.zeros(2 * p.A.getSize()[:1])
    for cell, matrix in zip(cells, K, strict=True):
        blocks = dof_map.local_to_global[dof_map.cell_blocks[cell, :nodes]]
        first, size = dof_map.global_dofs(blocks)
        dofs = np.concatenate([np.arange(f, f + s) for f, s in zip(first, size, strict=True)])
        expected[np.ix_(dofs, dofs)] += matrix
    expected = comm.allreduce(expected)
    found = dense(p.A)
    start = p.A.getOwnershipRange()[0]
    fixed = np.concatenate(comm.allgather(p.constrained_dofs + start))
    expected[fixed] = expected[:, fixed] = 0.0
    expected[fixed, fixed] = p.matrix.constrained_diagonal
    assert len(fixed) and p.matrix.constrained_diagonal > 0
    np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("element", ["Q1", "P2P1"])
def test_layout_with_no_further_pairs(element: str) -> None:
    """One rank needs no exchange; with further pairs, even none, the general way is taken."""
    comm = MPI.COMM_WORLD
    p = problem(cube(comm, "tetrahedron" if element[0] == "P" else "hexahedron"), element)
    dof_map = p.matrix._dof_map
    layout, other = (MatrixLayout(dof_map, pairs) for pairs in (None, np.empty((0, 2), np.int64)))
    assert np.array_equal(layout.block_positions, other.block_positions)
    assert np.array_equal(layout.row_strides, other.row_strides)
    assert layout.num_values == other.num_values
    for found, expected in zip(layout.mat.getValuesCSR(), other.mat.getValuesCSR(), strict=True):
        assert np.array_equal(found, expected)
