"""Rigid motions of obstacles, from tables of poses and displacements."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fem_snh.geometry.motion_files import read_motion
from fem_snh.geometry.motions import DisplacementMotion, MovingShape
from fem_snh.geometry.shapes import Box

pytestmark = pytest.mark.one_debian

BOX = Box((0.1, 0.2, -0.1), (1.0, 0.6, 0.8))
TURN, SHIFT = np.array([0.4, -0.3, 0.7]), np.array([0.3, -1.0, 2.0])
PRESS = "load, x, y, z, rx, ry, rz\n0, 0, 0, 0, 0, 0, 0\n1, 0.3, -1, 2, 0.4, -0.3, 0.7\n"


@pytest.fixture
def written(tmp_path):
    """Return a function that writes a CSV file and reads the motion."""

    def read(text, **options):
        (tmp_path / "press.csv").write_text(text)
        return read_motion(tmp_path / "press.csv", **options)

    return read


def moved(X, load):
    """Return displacements of the same motion as PRESS, as `[[move]]` would."""
    return Rotation.from_rotvec(load * TURN).apply(X) + load * SHIFT - X


def test_a_table_of_two_rows_turns_and_moves_in_proportion_to_the_load(written):
    table, formula = written("# made by hand\n" + PRESS), DisplacementMotion(moved)
    for load in (0.0, 0.3, 1.0):
        assert np.allclose(table.pose(load).rotation, formula.pose(load).rotation, atol=1e-15)
        assert np.allclose(table.pose(load).translation, load * SHIFT, atol=1e-15)


def test_distance_and_derivatives_move_with_the_obstacle(written):
    obstacle = MovingShape(BOX, written(PRESS))
    X = np.random.default_rng(1).normal(0, 1, (50, 3))
    R = Rotation.from_rotvec(0.6 * TURN).as_matrix()
    rest, now = BOX.evaluate(X), obstacle.evaluate(X @ R.T + 0.6 * SHIFT, 0.6)
    assert now.distance == pytest.approx(rest.distance, abs=1e-14)
    assert np.allclose(now.gradient, rest.gradient @ R.T, atol=1e-14)
    assert np.allclose(now.hessian, np.einsum("ia,nab,jb->nij", R, rest.hessian, R), atol=1e-12)


def test_displacements_of_material_points(written):
    obstacle = MovingShape(BOX, written(PRESS))
    X = np.random.default_rng(2).normal(0, 1, (5, 3))
    early, late = X + moved(X, 0.2), X + moved(X, 0.9)
    assert np.allclose(obstacle.displacement(early, 0.2, 0.9), late - early, atol=1e-14)
    assert np.allclose(obstacle.displacement(late, 0.9, 0.2), early - late, atol=1e-14)
    assert not MovingShape(BOX).displacement(X, 0.0, 1.0).any()


def test_a_table_of_matrices(written):
    names = [f"a{i}{j}" for i in (1, 2, 3) for j in (1, 2, 3, 4)]
    rows = [",".join(["time", *names])]
    for load in (0.0, 0.5, 1.0):
        matrix = np.column_stack([Rotation.from_rotvec(load * TURN).as_matrix(), load * SHIFT])
        rows.append(",".join([f"{4 * load}", *(f"{a:.9f}" for a in matrix.ravel())]))
    motion = written("\n".join(rows), duration=4.0)
    R = Rotation.from_rotvec(0.75 * TURN).as_matrix()
    assert np.allclose(motion.pose(0.75).rotation, R, atol=1e-8)
    assert np.allclose(motion.pose(0.75).rotation.T @ motion.pose(0.75).rotation, np.eye(3))
    assert np.allclose(MovingShape(BOX, motion).affine(1.0), np.c_[motion.pose(1.0)], atol=1e-15)
