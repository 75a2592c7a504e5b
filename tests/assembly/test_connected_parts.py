"""Connected parts of chosen cells, beside scipy's on all cells of all ranks."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx.mesh import CellType, create_unit_cube
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from fem_snh import _dolfinx
from fem_snh.assembly.connected_parts import connected_parts

pytestmark = pytest.mark.mpi


def test_parts_of_random_cells(comm):
    """No cell, many parts of few cells, few of many: the same nodes are together.

    The choice is a function of the cells' midpoints, the same on any number of ranks.
    """
    domain = create_unit_cube(comm, 6, 5, 7, CellType.tetrahedron)
    counts = []
    for degree in (1, 2):
        V = _dolfinx.function_space(domain, degree, (3,))
        X, nodes = V.tabulate_dof_coordinates(), _dolfinx.node_dofs(V)
        values = np.sin(1e4 * X[nodes].mean(axis=1) @ [1.1, 1.7, 2.3])
        for share in (0.0, 0.02, 0.05, 0.1, 0.2, 1.0):
            chosen = np.flatnonzero(values < np.sin(np.pi * (share - 0.5)))
            counts.append(check(comm, V, chosen))
    assert counts[0] == 0 and counts[5] == 1 and max(counts) > 10


def check(comm, V, chosen) -> int:
    """Compare with scipy's components of the gathered cells; return the number of parts."""
    part, count = connected_parts(V, chosen)
    nodes, numbers = _dolfinx.node_dofs(V), _dolfinx.local_to_global(V)
    cells = np.concatenate(comm.allgather(numbers[nodes[chosen]]))
    size = comm.allreduce(_dolfinx.num_nodes(V)[0])
    first = np.repeat(cells[:, :1], cells.shape[1], axis=1)
    entries = np.ones(cells.size), (first.ravel(), cells.ravel())
    label = connected_components(coo_matrix(entries, shape=(size, size)), directed=False)[1]
    inside = np.isin(numbers, cells)
    assert np.array_equal(part >= 0, inside)
    assert count == len(np.unique(label[cells]))
    pairs = np.concatenate(comm.allgather(np.column_stack([label[numbers], part])[inside]))
    assert len(np.unique(pairs, axis=0)) == count
    assert set(pairs[:, 1]) == set(range(count))
    return count
