"""The eigenvalue filters."""

from __future__ import annotations

import numpy as np
import pytest
from points import KINDS, deformations, every_kind, every_material, filtered, make, spread

from fem_snh.choices import EIGENSOLVERS, FILTERS


@pytest.mark.parametrize("solver", EIGENSOLVERS)
@pytest.mark.parametrize("filter", ["clamp", "abs"])
@every_kind
@every_material
def test_filters_against_numpy(m, kind, filter, solver):
    m = make(*m)
    F = deformations(KINDS[kind], seed=1)
    H, found = m.hessian(F, "exact", solver), m.hessian(F, filter, solver)
    assert np.isfinite(H).all()
    assert np.isfinite(found).all()
    size = spread(H)[:, None, None]
    assert np.all(abs(found - filtered(H, filter)) <= 5e-15 * size)
    assert np.all(found == np.swapaxes(found, 1, 2))
    assert np.all(np.linalg.eigvalsh(found / size) >= -5e-15)


@every_kind
@every_material
def test_the_objective_hessian_has_no_stiffness_of_spins(m, kind):
    """The clamped one, projected by numpy onto what is orthogonal to W F for all skew W."""
    m = make(*m)
    F = deformations(KINDS[kind], seed=1)
    clamped, found = m.hessian(F, "clamp"), m.hessian(F, "objective")
    skew = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        skew[i, k, j], skew[i, j, k] = 1.0, -1.0
    spins = np.einsum("wij,njk->nwki", skew, F).reshape(len(F), 3, 9)  # by columns
    size = spread(clamped)[:, None]
    moved = abs(np.einsum("nij,nwj->nwi", found, spins)).max(axis=1)
    assert np.all(moved <= 1e-14 * size * abs(F).max(axis=(1, 2))[:, None])
    assert np.all(np.linalg.eigvalsh(found / size[..., None]) >= -1e-14)
    regular = np.linalg.svd(F, compute_uv=False)[:, 1] > 1e-2 * abs(F).max(axis=(1, 2))
    basis = np.linalg.qr(np.swapaxes(spins[regular], 1, 2))[0]
    kept = np.eye(9) - basis @ np.swapaxes(basis, 1, 2)
    expected = kept @ clamped[regular] @ kept
    assert np.all(abs(found[regular] - expected) <= 1e-13 * size[regular, None])


@every_material
def test_a_point_does_not_depend_on_its_neighbours(m):
    """Eight points are evaluated at a time; the neighbours depend on the number of ranks."""
    m = make(*m)
    F = deformations(np.concatenate([KINDS[k] for k in KINDS])[::7], seed=4)
    for filter in FILTERS:
        alone = np.array([m.hessian(f, filter) for f in F])
        assert np.array_equal(m.hessian(F, filter), alone)
