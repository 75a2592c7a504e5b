"""Helpers of the other modules of this package."""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

Array = np.ndarray


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress what compiling a form says, which no user can change.

    Log records of level INFO, with dolfinx 0.5, and that a rule of a high degree has many points:
    the program chooses the degrees.
    """
    before = logging.root.manager.disable
    logging.disable(max(before, logging.INFO))
    try:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Number of integration points per cell")
            yield
    finally:
        logging.disable(before)


def _rows(table: Any, width: int) -> Array:
    """Return a dofmap or connectivity as a (rows, width) array, also without rows."""
    # Connectivities are adjacency lists; so are the dofmaps of 0.5 (arrays since 0.7).
    return np.asarray(getattr(table, "array", table)).reshape(-1, width)
