"""The rule of bounds: what two and three levels say of an error."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fem_snh.accuracy.effectivity import MISSED, measure, of_order

SIZES = st.floats(0.01, 100.0)


def test_two_levels_measure_what_an_estimate_misses() -> None:
    """All levels miss a part of the error: one pair takes the mean, the next one is exact."""
    error = np.array([[0.8, -0.4], [0.4, -0.2], [0.2, -0.1]])
    values, estimates = np.array([3.0, 5.0]) - error, error / 1.8
    once, twice = measure(values[:2], estimates[:2]), measure(values, estimates)
    assert once.theta == twice.theta == pytest.approx(1.8)
    assert once.factor == pytest.approx(1.4) and not once.confirmed
    left = values[1] + once.factor * estimates[1] - [3.0, 5.0]
    assert (abs(left) <= once.bounds).all()
    assert twice.confirmed
    assert values[2] + twice.factor * estimates[2] == pytest.approx([3.0, 5.0])


def test_the_levels_of_a_cross_point() -> None:
    """Stiff quadrants that meet at a point, contrast 100: graded meshes give 0.0724."""
    values = np.array([[0.14187, 0.10881, 0.09567, 0.08813, 0.08281, 0.07896]]).T
    errors = -np.array([[0.03065, 0.01498, 0.00848, 0.00556, 0.00407, 0.00261]]).T
    for k in range(2, 7):
        found = measure(values[max(k - 3, 0) : k], errors[max(k - 3, 0) : k])
        best = values[k - 1] + found.factor * errors[k - 1]
        assert abs(best - 0.0724) < found.bounds
        assert found.theta > 2


@given(st.floats(0.3, 3.0), st.floats(0.1, 0.9), st.lists(SIZES, min_size=1, max_size=3))
def test_bounds_hold_for_any_effectivity_that_levels_share(theta, ratio, sizes) -> None:
    """Of errors that decrease by a ratio: with two levels, and exactly with three."""
    error = np.array([np.array(sizes) * ratio**k for k in range(3)])
    values, estimates = -error, error / theta
    for first in (1, 0):
        found = measure(values[first:], estimates[first:])
        assert found.theta == pytest.approx(theta)
        left = np.abs(values[-1] + found.factor * estimates[-1])
        assert (left <= found.bounds * (1 + 1e-9) + 1e-12).all()
    if abs(theta - 1) > MISSED * (1 + 1e-9):
        assert left == pytest.approx(0, abs=1e-9 * max(sizes))


@given(st.floats(0.5, 3.0), st.floats(1.5, 4.0), SIZES)
def test_an_unknown_order_is_measured(order, ratio, size) -> None:
    """Values 3 + c h^p of which another order is assumed: bounds hold, and units do not matter."""
    values = [np.array([3.0 + size * ratio ** (-order * k)]) for k in range(3)]
    error, missed = of_order(values, [ratio**2] * 2)
    assert abs(3.0 - values[-1] - error) <= missed * (1 + 1e-6) + 1e-12 * size
    scaled = of_order([1e6 * value for value in values], [ratio**2] * 2)
    assert scaled[1] == pytest.approx(1e6 * missed, rel=1e-6, abs=1e-9)


def test_changes_that_do_not_decrease_have_a_bound() -> None:
    """Three equal changes say nothing of a limit: four of them, as a ratio of 0.8 leaves."""
    error, missed = of_order([np.array([float(k)]) for k in range(3)], [4.0, 4.0])
    assert missed + error >= 4.0
