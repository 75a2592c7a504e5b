"""Prescribed displacements: rotations, translations, and constrained groups."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from fem_snh.scenes import Move, Rotate

pytestmark = pytest.mark.one_debian

VECTOR = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)


@given(VECTOR.filter(lambda v: np.linalg.norm(v) > 1e-3), st.floats(-7, 7), VECTOR, st.floats(0, 1))
def test_rotation_is_the_exponential(axis: Any, angle: float, through: Any, load: float) -> None:
    X = np.random.default_rng(0).standard_normal((5, 3))
    turn = Move(group=1, rotate=Rotate(axis=axis, angle=angle, through=through))
    k = load * angle * axis / np.linalg.norm(axis)
    R = expm(np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]]))
    np.testing.assert_allclose(
        X + turn.displacement(X, load), through + (X - through) @ R.T, atol=1e-13
    )


def test_a_move_turns_first_and_shifts_then() -> None:
    rotate = Rotate(axis=(0, 0, 1), angle=np.pi / 2)
    both = Move(group=1, rotate=rotate, translate=(1, 0, 0))
    X = np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(X + both.displacement(X, 1), [[1, 1, 0]], atol=1e-15)
    apart = Move(group=1, rotate=rotate), Move(group=1, translate=(1, 0, 0))
    total = sum(move.displacement(X, 0.3) for move in apart)
    np.testing.assert_allclose(both.displacement(X, 0.3), total, atol=1e-15)
