"""The pattern of the pairs of blocks of cells, against a dense matrix."""

from __future__ import annotations

import numpy as np

from fem_snh.kernels.block_pattern import CellPattern


def test_pattern_and_positions_of_cells():
    random = np.random.default_rng(1)
    cells = np.array([random.permutation(40)[:7] for _ in range(30)], dtype=np.int32)
    dense = np.zeros((40, 40), dtype=bool)
    for cell in cells:
        dense[np.ix_(cell, cell)] = True
    pattern = CellPattern(cells, 40)
    rows, columns = np.nonzero(dense)
    assert (pattern.rows() == rows).all()
    assert (pattern.indices == columns).all()
    assert (pattern.indptr == np.concatenate([[0], np.cumsum(dense.sum(axis=1))])).all()
    numbers = 40 * rows + columns
    expected = 40 * cells[:, :, None] + cells[:, None, :]
    assert (pattern.of_cells(numbers) == expected).all()


def test_no_cells():
    pattern = CellPattern(np.empty((0, 4), dtype=np.int32), 3)
    assert not pattern.indices.size
    assert not pattern.indptr.any()
