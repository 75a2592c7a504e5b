"""The measurements of docs/results/elements.md, small: what they say of an element."""

from __future__ import annotations

import pytest

from benchmarks import two_dimensions, volume_split

pytestmark = pytest.mark.one_debian


def test_bound_keeps_taylor_hood_cells_from_collapsing() -> None:
    none, some = volume_split.rows(elements="Q2Q1", bounds="0,2", stretches="1,0.5", cells=2)
    assert none["least"]["0.5"] < 0 < some["least"]["0.5"]
    assert none["spurious"] == some["spurious"] == 0
    assert some["converged"] and len(some["newton"]) == 2 and some["min_J"][1] > 0.7


def test_sections_of_the_bushing_and_the_tube(monkeypatch):
    """The parts that are asked for, to the finest mesh; with at most two cells in a wall."""
    solved = two_dimensions.solved
    monkeypatch.setattr(
        two_dimensions,
        "solved",
        lambda scene, cells, **keys: solved(scene, cells=min(cells, 2), **keys),
    )
    rows = list(two_dimensions.rows(parts="tube,bushing", finest=2))
    assert [row["cells"] for row in rows] == [2, 2, 1, 2, 1, 2, 4]
    assert max(row["error"] for row in rows[:2]) < 1e-3
