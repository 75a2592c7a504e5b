"""The number of quadrature points with a negative eigenvalue, which every filter reports."""

from __future__ import annotations

import numpy as np
import pytest
from points import make

from fem_snh.assembly.cell_loops import CellLoops, ElementTables, compile_cell_loops
from fem_snh.choices import FILTERS

GRADIENTS = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])


def count(m, F: np.ndarray, filter: str) -> int:
    """The count of the Jacobian of disconnected tetrahedra, one point each, with these F."""
    n = len(F)
    nodes = np.arange(4 * n, dtype=np.int32).reshape(n, 4)
    corners = np.maximum(GRADIENTS, 0)
    g, weights = GRADIENTS[None], np.array([1 / 6])
    tables = ElementTables(nodes, nodes, np.tile(corners, (n, 1)), g, g, weights)
    loops = CellLoops(compile_cell_loops(m, tables), tables)
    # Every element matrix is added to the same 3x3 block: only the count matters here.
    stride, position = np.full(4 * n, 3, np.int32), np.zeros((n, 4, 4), np.int32)
    values, free, constrained = np.zeros(9), np.ones((4 * n, 3)), np.zeros(n, np.uint8)
    target = loops.target([stride] * 3, position, free, constrained)
    target.values[0] = loops.pointer(values)
    u = np.einsum("nij,aj->nai", F - np.eye(3), corners)
    return loops.jacobian(u.ravel(), FILTERS.index(filter), target)


def samples() -> np.ndarray:
    """Deformation gradients at rest, random, nearly singular, compressed and inverted."""
    sizes = np.repeat([0.05, 0.5], 25)[:, None, None]
    random = np.eye(3) + sizes * np.random.default_rng(0).standard_normal((50, 3, 3))
    stretches = [
        (1, 1, 1), (2, 1, 0.5), (3.4, 0.6, 0.5), (0.3, 0.3, 0.3), (1.2, 1, 0), (1.4, 0.9, -0.6),
    ]  # fmt: skip
    return np.concatenate([random, [np.diag(s).astype(float) for s in stretches]])


@pytest.mark.one_debian
@pytest.mark.parametrize("filter", FILTERS)
@pytest.mark.parametrize("name", ["stable_neo_hookean", "neo_hookean", "stvk", "hencky"])
def test_every_filter_counts_the_points_with_a_negative_eigenvalue(name, filter):
    m, F = make(name, 0.45), samples()
    values = m.eigensystem(F)[0]
    size = abs(values).max(axis=-1)
    zero = abs(values).min(axis=-1) <= 1e-12 * size  # the sign is rounding, or psi is infinite
    F, expected = F[~zero], (values[~zero] < 0).any(axis=-1)
    assert 0 < expected.sum() < len(F)
    assert count(m, F, filter) == expected.sum()
