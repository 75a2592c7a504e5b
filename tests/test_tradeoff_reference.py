"""References of a study: order of convergence, extrapolation, a check by a second element."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from fem_snh.studies.tradeoff.reference import (
    ReferenceValue,
    establish,
    estimate,
    extrapolate,
    mesh_sequence,
    observed_order,
    reference_message,
)  # fmt: skip


def values(h: list[float], p: float, limit: float = 3.0, amount: float = 0.2) -> list[np.ndarray]:
    return [np.array([limit + amount * width**p, 1 - amount * width**p]) for width in h]


@given(
    st.floats(0.9, 3.9), st.lists(st.floats(1.2, 3.0), min_size=2, max_size=4), st.floats(0.05, 0.3)
)
def test_richardson_finds_order_and_limit(p: float, ratios: list[float], amount: float) -> None:
    """Whatever the ratios of the widths, which need not be the same."""
    h = [1.0]
    for ratio in ratios:
        h.append(h[-1] / ratio)
    found = values(h, p, amount=amount)
    assert observed_order(h[-3:], found[-3:]) == pytest.approx(p, abs=1e-4)
    limit, order = extrapolate(h, found)
    assert limit == pytest.approx([3, 1], abs=1e-5) and order == pytest.approx(p, abs=1e-4)


def test_no_order_no_extrapolation() -> None:
    """Differences that do not fall, or hardly: the finest value, and an error of their size."""
    h = [1.0, 0.5, 0.25]
    growing = [np.array([v]) for v in (1.0, 1.1, 1.3)]
    found = estimate("Q2", "4 cells", h, growing)
    assert found is not None and found.value == [1.3] and np.isnan(found.order)
    assert found.error == pytest.approx(0.2 / 1.3)
    slow = [np.array([v]) for v in (1.0, 1.1, 1.19)]
    assert extrapolate(h, slow)[0] == [1.19]
    assert np.isnan(observed_order(h, [np.ones(1)] * 3))
    assert estimate("Q2", "2 cells", h[:2], growing[:2]) is None


def test_meshes_that_are_spread() -> None:
    """A mesh between two others is for advice, not for the order."""
    assert mesh_sequence([1 / n for n in (2, 4, 8, 16, 24, 32, 64)]) == [0, 1, 2, 3, 5, 6]
    assert mesh_sequence([1 / n for n in (2, 3, 4, 6)]) == [0, 1, 2, 3]


def test_an_order_that_is_chance_is_not_believed() -> None:
    """As order 9 would have it, the last value is the limit."""
    h = [1.0, 0.5, 0.25]
    limit, order = extrapolate(h, values(h, 9.0))
    assert order == pytest.approx(9, abs=1e-3)
    last, before = values(h, 9.0)[-1], values(h, 9.0)[-2]
    assert limit - last == pytest.approx((last - before) / (2**4 - 1))


def reference(value: float, error: float, element: str = "Q2") -> ReferenceValue:
    return ReferenceValue(np.array([value]), error, error, element, "8 cells", 2.0)


def test_a_second_element_may_raise_the_error() -> None:
    assert establish([]) is None
    alone = establish([reference(1.0, 0.01)])
    assert alone is not None and alone.error == 0.01 and not alone.checked
    agreed = establish([reference(1.0, 0.02, "Q2"), reference(1.01, 0.01, "Q2Q1")])
    assert agreed is not None and (agreed.element, agreed.checked) == ("Q2Q1", "Q2")
    assert agreed.error == 0.01
    apart = establish([reference(1.0, 0.01), reference(1.5, 0.02, "Q2Q1")])
    assert apart is not None and apart.error == pytest.approx(0.5 - 0.02)


def test_what_a_reference_cannot_resolve_is_rejected() -> None:
    good = reference(1.0, 0.001)
    assert reference_message("energy", good, {"a": 0.02}).endswith("resolves errors above 1 %")
    assert "rejected" in reference_message("energy", good, {"a": 0.009})
    assert "three meshes" in reference_message("energy", None, {})
