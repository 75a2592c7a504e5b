"""The columns of unknowns of a pattern of blocks, against a dense one."""

from __future__ import annotations

import numpy as np
import pytest

from fem_snh.kernels.block_pattern import BlockPattern, unknown_columns


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
