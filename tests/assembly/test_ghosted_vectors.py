"""Nodal values with those of ghosts."""

from __future__ import annotations

import gc

import numpy as np
import pytest
from bodies import cube, problem

from fem_snh import _dolfinx
from fem_snh.assembly.unknowns import ghosted, with_ghosts

mpi = pytest.mark.mpi


@mpi
def test_values_do_not_depend_on_a_vector_that_is_gone(comm):
    """Vectors of the same size, made after, get the memory of those that are freed."""
    V = problem(cube(comm, "hexahedron", 6, 0.0), "Q1", hold=[], E=1.0).V
    X, owned = V.tabulate_dof_coordinates(), _dolfinx.num_nodes(V)[0]
    found = [with_ghosts(V, (k + X[:owned]).ravel()) for k in range(20)]
    gc.collect()
    others = [ghosted(V, np.full(3 * owned, np.nan)) for _ in range(40)]
    for k, values in enumerate(found):
        assert values.reshape(-1, 3) == pytest.approx(k + X, abs=1e-12)
    assert np.isnan(others[0].array_r).all()
