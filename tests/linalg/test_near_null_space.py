"""Rigid motions: the null space of the stiffness matrix at rest, and what they leave unchanged."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import MINIMISING, Hold, constrained, cube, every_energy, problem, set_values

from fem_snh.assembly.elements import ELEMENTS

mpi = pytest.mark.mpi
elements = pytest.mark.parametrize("element", MINIMISING)


# --- rigid motions -------------------------------------------------------------------------------


@pytest.mark.one_debian
@mpi
@elements
def test_near_null_space_under_conditions(comm, element):
    """Six orthonormal vectors, zero where the displacement is prescribed."""
    p = problem(
        cube(comm, ELEMENTS[element].cell, 2), element, hold=[Hold("left"), Hold("top", ("x",))]
    )
    vectors = p.A.getNearNullSpace().getVecs()
    gram = np.array([[v.dot(w) for w in vectors] for v in vectors])
    assert abs(gram - np.eye(6)).max() <= 1e-12
    assert not any(v.array_r[constrained(p)].any() for v in vectors)


@pytest.mark.one_debian("ranks")
@every_energy
def test_a_rotated_body_is_at_rest(comm, name):
    angle = 2.5
    c, s = np.cos(angle), np.sin(angle)
    R = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    p = problem(cube(comm, "hexahedron", 2, 0.05), "Q1", name)
    set_values(p, lambda X: X @ R.T - X + [1, 2, 3])
    r = p.x.duplicate()
    p.gradient(p.x, r)
    assert p.energy(p.x) == pytest.approx(0, abs=1e-14)
    assert r.norm() <= 1e-13
    corners = np.indices((2, 2, 2)).reshape(3, -1).T  # the norm of an affine map is convex
    furthest = np.linalg.norm(corners @ R.T - corners + [1, 2, 3], axis=1).max()
    measured = {"volume_ratio": 1.0, "min_J": 1.0, "min_cell_J": 1.0, "max_u": furthest}
    assert p.measures(p.x) == pytest.approx(measured, rel=1e-12)
