"""The pattern of a matrix of blocks, against scipy's."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_matrix

from fem_snh.assembly.matrix_layout import BlockSparsity
from fem_snh.kernels.block_pattern import BlockPattern, unknown_columns


@pytest.mark.parametrize("n", [0, 1, 3000])
def test_pattern_of_repeated_pairs(n):
    random = np.random.default_rng(n)
    rows, columns = random.integers(0, 60, n), random.integers(0, 40, n)
    pattern = BlockPattern(rows, columns, 70, 50)
    expected = coo_matrix((np.ones(n), (rows, columns)), shape=(70, 50)).tocsr()
    assert np.array_equal(pattern.indptr, expected.indptr)
    assert np.array_equal(pattern.indices, expected.indices)
    assert np.array_equal(pattern.indices[pattern.find(rows, columns)], columns)


def test_offsets_of_blocks_of_several_sizes():
    """Rows of 3 and 1 unknowns, the values of each row of unknowns contiguous, as in AIJ."""
    sizes = np.array([3, 3, 1])
    pattern = BlockPattern(np.array([0, 0, 2, 1]), np.array([2, 0, 2, 1]), 3, 3)
    sparsity = BlockSparsity(pattern, sizes, sizes)
    assert sparsity.block_offsets.tolist() == [0, 3, 12, 21]
    assert sparsity.row_lengths.tolist() == [4, 3, 1]
    offsets = sparsity.offsets(np.array([0, 0, 1, 2]), np.array([0, 2, 1, 2]))
    assert offsets.tolist() == [0, 3, 12, 21]


@pytest.mark.parametrize("seed", range(4))
def test_columns_of_unknowns_are_those_of_a_dense_pattern(seed):
    """Blocks of 3 and 1 unknowns; the columns of this rank lie between those of others."""
    random = np.random.default_rng(seed)
    sizes = random.choice([1, 3], 30)
    unknown = np.cumsum(sizes) - sizes
    pattern = random.random((30, 30)) < 0.2
    mine = slice(*np.sort(random.integers(0, 31, 2)))
    others = np.delete(np.arange(30), mine)
    parts = []
    for columns in (np.arange(30)[mine], others):
        rows, chosen = np.nonzero(pattern[mine][:, columns])
        part = BlockPattern(rows, chosen, len(sizes[mine]), len(columns))
        parts.append((part.indptr, part.indices, unknown[columns], sizes[columns]))
    dense = np.repeat(np.repeat(pattern[mine], sizes, axis=1), sizes[mine], axis=0)
    rows, expected = np.nonzero(dense)
    found = unknown_columns(sizes[mine], *parts, mine.start, len(rows))
    assert np.array_equal(found, expected)
