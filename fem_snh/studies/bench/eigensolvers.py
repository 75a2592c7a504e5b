"""Accuracy and cost of the 3x3 eigensolvers: `fem_snh.studies.eigensolvers`."""

from __future__ import annotations

from collections.abc import Iterator

from fem_snh.studies.bench import Row
from fem_snh.studies.eigensolvers import eigensolvers


def rows(samples: int = 30, points: int = 2000, seed: int = 0) -> Iterator[Row]:
    """One row per kind of stretches; errors against 50 digits, relative to the block's norm."""
    return eigensolvers(samples, points, seed)
