"""Motions of bones: tables of affine maps, skeletons, functions, noise, and their mistakes."""

from __future__ import annotations

import re

import numpy as np
import pytest
from bone_scenes import LOWER, UPPER, bar, csv_text, matrix, turn

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.geometry.motions import Noise
from fem_snh.scenes._bones import read_bones

pytestmark = pytest.mark.one_debian

#: Affine and not rigid, as production skinning has it.
SKEWED = matrix([[1.1, 0.2, 0.0], [-0.1, 0.95, 0.05], [0.0, 0.1, 1.0]], (0.05, -0.02, 0.03))
REST = matrix(np.eye(3))


@pytest.fixture
def read(tmp_path):
    """Return a function that returns the motions of a scene, after writing its file."""

    def motions(text=None, name="arm.csv", file_name=None, **keys):
        if text is not None:
            (tmp_path / (file_name or name)).write_text(text)
        own = {key: keys.pop(key) for key in ("motion", "rigid") if key in keys}
        motion = own.get("motion", str(tmp_path / name))
        upper = {"name": "upper", "shape": UPPER, **own, "motion": motion}
        scene = bar(upper, {"name": "lower", "shape": LOWER}, **keys)
        assert scenes.load(scene) == scene
        return read_bones(scene)[0]

    return motions


def test_a_table_is_linear_in_each_entry(read):
    rows = (0.0, "upper", REST), (0.5, "upper", SKEWED), (1.0, "upper", turn(1.0))
    motion = read(csv_text("load", *rows)).motion
    assert motion.affine(0.25) == pytest.approx((REST + SKEWED) / 2, abs=1e-15)
    assert motion.affine(0.5) == pytest.approx(SKEWED, abs=0)
    assert motion.affine(0.75) == pytest.approx((SKEWED + turn(1.0)) / 2, abs=1e-15)
    assert motion.affine(2.0) == pytest.approx(turn(1.0), abs=0)


def test_a_rigid_table_is_slerped_and_the_translation_linear(read):
    rows = [(4 * load, "upper", turn(2 * load, (1, 1, 0))) for load in (0.0, 0.5, 1.0)]
    text = csv_text("time", *rows)
    time = {"duration": 4.0, "steps": 2}
    dense = {"name": "stable_neo_hookean", "E": 1e4, "nu": 0.45, "density": 1e3}
    motion = read(text, rigid=True, time=time, material=dense).motion
    for load in (0.25, 0.75):
        R = turn(2 * load, (1, 1, 0))[:, :3]
        assert motion.affine(load)[:, :3] == pytest.approx(R, abs=1e-14)
    middle = (rows[0][2][:, 3] + rows[1][2][:, 3]) / 2
    assert motion.affine(0.25)[:, 3] == pytest.approx(middle, abs=1e-15)


@pytest.mark.parametrize(
    "function, message",
    [
        (lambda load: np.eye(3), "at load 0.5 = array.*: expected a 3x4 matrix"),
        (lambda load: "up", "at load 0.5: ValueError"),
        (lambda load: np.full((3, 4), np.nan), "expected a 3x4 matrix [A | c] of finite numbers"),
        (lambda load: np.eye(3, 4) * -1, "at load 0.5: det A = -1: expected a determinant > 0"),
    ],
)
def test_functions_that_return_no_affine_map(read, function, message):
    bone = read(motion=function)
    with pytest.raises(BadInput, match=re.escape(message).replace(r"\.\*", ".*")):
        bone.affine(0.5)


def test_noise_is_bounded_and_depends_on_seed_and_name():
    centre, L, a = np.array([1.0, 2.0, 3.0]), 0.4, 0.05
    noise = Noise(a, 7, 200)
    maps = noise.maps("ulna", centre, L)
    X = np.random.default_rng(0).normal(size=(300, 3))
    X = centre + L / 2 * X / np.linalg.norm(X, axis=1)[:, None]
    moved = np.linalg.norm(
        np.einsum("fij,nj->fni", maps[:, :, :3], X) + maps[:, None, :, 3], axis=2
    )
    assert not maps[0].any() and 0.7 * a * L < moved.max() <= a * L
    # The mean square of t is 3/5 of 1/4, that of B e is 9/11 of 1/3: exact moments of the balls.
    expected = (a * L) ** 2 * (3 / 5 / 4 + 9 / 11 / 3 / 4)
    assert (moved[1:] ** 2).mean() == pytest.approx(expected, rel=0.1)
    motion = noise.motion("ulna", centre, L)
    assert motion(0.5) == pytest.approx(maps[100], abs=1e-15)
    assert motion(0.5025) == pytest.approx((maps[100] + maps[101]) / 2, abs=1e-13)
    assert np.array_equal(maps, Noise(a, 7, 200).maps("ulna", centre, L))
    for other in (Noise(a, 8, 200).maps("ulna", centre, L), noise.maps("radius", centre, L)):
        assert not np.allclose(maps[1:], other[1:])
