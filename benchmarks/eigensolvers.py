"""Accuracy and cost of the 3x3 eigensolvers: `benchmarks.eigensolver_accuracy`."""

from __future__ import annotations

from collections.abc import Iterator

from benchmarks import Row
from benchmarks.eigensolver_accuracy import eigensolvers


def rows(samples: int = 30, points: int = 2000, seed: int = 0) -> Iterator[Row]:
    """One row per kind of stretches; errors against 50 digits, relative to the block's norm."""
    return eigensolvers(samples, points, seed)
