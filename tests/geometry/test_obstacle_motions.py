"""Rigid motions of obstacles, from tables of poses and displacements."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from fem_snh.errors import BadInput
from fem_snh.geometry.motion_files import read_motion
from fem_snh.geometry.motions import DisplacementMotion, MovingShape, Pose
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


def test_a_pose_and_its_inverse():
    pose = Pose(Rotation.from_rotvec(TURN).as_matrix(), SHIFT)
    X = np.random.default_rng(3).normal(0, 1, (5, 3))
    assert np.allclose(pose.invert(pose.apply(X)), X, atol=1e-14)


AFFINE = "load,a11,a12,a13,a14,a21,a22,a23,a24,a31,a32,a33,a34\n0,1,0,0,0,0,1,0,0,0,0,1,0\n"


@pytest.mark.parametrize(
    "text, message",
    [
        ("", "expected a line of column names and two rows or more"),
        ("load,x,y,z\n0,0,0,0\n", "expected a line of column names and two rows or more"),
        ("0,0,0,0\n0.5,0,0,0\n1,0,0,0\n", "press.csv': unknown column '0': expected one of load"),
        ("load,x,y,zz\n0,0,0,0\n1,0,0,0", "unknown column 'zz': .* (did you mean 'z'?)"),
        ("load,x,y\n0,0,0\n1,0,0", "expected the columns: a first column 'load' or 'time'"),
        ("x,y,z,load\n0,0,0,0\n0,0,0,1", "expected the columns: a first column 'load' or 'time'"),
        ("load,x,y,z\n0,0,0,0\n1,0,0", "press.csv, line 3: expected 4 numbers, found 3"),
        ("load,x,y,z\n0,0,0,0\n1,0,a,0", "press.csv, line 3: y = 'a': expected a finite number"),
        ("load,x,y,z\n0,0,0,0\n1,0,nan,0", "line 3: y = 'nan': expected a finite number"),
        ("time,x,y,z\n0,0,0,0\n1,0,0,0", "a column 'load' instead of 'time', as the scene has no"),
        ("load,x,y,z\n0,0,0,0\n0.7,0,0,0\n0.7,0,0,0", "line 4: load = 0.7: expected more than 0.7"),
        ("load,x,y,z\n0.1,0,0,0\n1,0,0,0", "line 2: load = 0.1: expected 0"),
        ("load,x,y,z\n0,0,0,0\n\n0.9,0,0,0", "line 4: load = 0.9: expected rows up to the load 1"),
        ("load,x,y,z,rx,ry,rz\n0,0,0,0,0,0,0\n1,0,0,0,0,0,6.28", "line 3: a turn of 360 degrees"),
        (AFFINE + "1,2,0,0,0,0,1,0,0,0,0,1,0", "line 3: expected a rotation in the first three"),
        (AFFINE + "1,1,0,0,0,0,0,0,0,0,0,1,0", "line 3: expected a rotation .*det R = 0"),
        (AFFINE + "1,-1,0,0,0,0,1,0,0,0,0,1,0", "line 3: expected a rotation .*det R = -1"),
        (AFFINE + "1,-1,0,0,0,0,-1,0,0,0,0,1,0", "line 3: a turn of 180 degrees"),
    ],
)
def test_mistakes_of_a_table(written, text, message):
    with pytest.raises(BadInput, match=re.sub(r"([(?)])", r"\\\1", message)) as error:
        written(text)
    assert "\n" not in str(error.value)


def test_a_table_in_time_that_ends_early(written):
    with pytest.raises(BadInput, match="time = 1: expected rows up to the end of the run, 2 s"):
        written("time,x,y,z\n0,0,0,0\n1,0,0,0", duration=2.0)


def test_a_file_that_is_not_there(tmp_path):
    (tmp_path / "press.csv").write_text(PRESS)
    with pytest.raises(BadInput, match=r"cannot read the motion .*did you mean 'press.csv'"):
        read_motion(tmp_path / "pres.csv")
