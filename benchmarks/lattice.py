"""Seconds that a lattice of 41,000 cells takes, around 24 capsules as in a hand."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from time import perf_counter, process_time
from typing import Any

import numpy as np

from fem_snh.geometry.shapes import Capsule, ClosedSurface, SmoothUnion
from fem_snh.mesh.lattice import lattice

#: Metacarpal and finger bones: distances of their ends from the wrist [m].
_JOINTS = (0.05, 0.09, 0.135, 0.165, 0.185)


def rows(cell: float = 0.00228) -> Iterator[dict[str, Any]]:
    """Yield the seconds for the shape, and for its skin as a closed surface.

    Parameters
    ----------
    cell : float
        Edge of a cell [m].
    """
    parts = [Capsule((-0.02, y, 0), (0.02, y, 0), 0.018) for y in (0.02, 0.04, 0.06, 0.08)]
    for angle in np.linspace(-0.7, 0.7, 5):
        direction = np.array([np.sin(angle), np.cos(angle), 0.0])
        ends = [tuple(r * direction) for r in _JOINTS]
        parts += [Capsule(a, b, 0.009) for a, b in pairwise(ends)]
    body = SmoothUnion(tuple(parts), 0.002)
    skin = None
    for kind in ("shape", "surface"):
        start, working = perf_counter(), process_time()
        if skin is None:
            data = lattice(body, cell)
            skin = data.skin
        else:
            data = lattice(ClosedSurface(skin.points, skin.triangles.astype(np.int64)), cell)
        assert data.skin is not None and data.fractions is not None
        yield {
            "body": kind,
            "parts": len(parts),
            "cells": len(data.cells),
            "nodes": len(data.x),
            "triangles": len(data.skin.triangles),
            "volume": float(data.fractions.sum() * cell**3),
            "seconds": perf_counter() - start,
            "processor_seconds": process_time() - working,
        }
