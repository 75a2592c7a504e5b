"""What the parts of the shim share."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

Array = np.ndarray


@contextmanager
def _quiet() -> Iterator[None]:
    """The compiler's chatter (INFO records of the root logger, 0.5 under Debian 12) unheard."""
    before = logging.root.manager.disable
    logging.disable(max(before, logging.INFO))
    try:
        yield
    finally:
        logging.disable(before)


def _rows(table: Any, width: int) -> Array:
    """A dofmap or connectivity as a (rows, width) array, also if this rank has no rows.

    Connectivities are adjacency lists, as dofmaps were in 0.5 (arrays since 0.7).
    """
    return np.asarray(getattr(table, "array", table)).reshape(-1, width)
