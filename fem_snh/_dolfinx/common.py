"""Helpers of the other modules of this package."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

Array = np.ndarray


@contextmanager
def _quiet() -> Iterator[None]:
    """Suppress log records of level INFO, which compiling a form emits with dolfinx 0.5."""
    before = logging.root.manager.disable
    logging.disable(max(before, logging.INFO))
    try:
        yield
    finally:
        logging.disable(before)


def _rows(table: Any, width: int) -> Array:
    """Return a dofmap or connectivity as a (rows, width) array, also without rows."""
    # Connectivities are adjacency lists; so are the dofmaps of 0.5 (arrays since 0.7).
    return np.asarray(getattr(table, "array", table)).reshape(-1, width)
