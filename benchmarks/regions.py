"""Assembly of several materials beside one, on the same mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np

from benchmarks import Row, split_list
from benchmarks.assembly import CELLS, Hessian, deformed, times
from fem_snh import _dolfinx
from fem_snh.assembly.regions import Region
from fem_snh.kernels.material import material

#: Time of several materials' assembly relative to one material's.
LIMIT = 1.05


def rows(
    elements: str = "Q1,P1,P2,Q2", counts: str = "2,4", cells: int = 0, repeat: int = 15
) -> Iterator[Row]:
    """Assemble the Hessian of layers of different moduli: one row per element and count.

    Parameters
    ----------
    elements : str
        Names of elements.
    counts : str
        Numbers of materials.
    cells : int
        Along the edge; default: those of the benchmark ``assembly``.
    repeat : int
        Assemblies of each kind, taken in turns; the ratio is the median of neighbours in time.
    """
    for name in split_list(elements):
        yield from measure(
            name, [int(n) for n in split_list(counts)], cells or CELLS.get(name, 8), repeat
        )


def measure(name: str, counts: list[int], cells: int, repeat: int) -> Iterator[Row]:
    """Yield the row of each number of materials."""
    domain, u = deformed(name, cells)
    x = _dolfinx.geometry_x(domain.domain)[_dolfinx.geometry_dofs(domain.domain)]
    height = x[:, :, 2].mean(axis=1)  # of each cell's centre, in [0, 1]
    made = {}
    for n in (1, *counts):
        layer = np.minimum((n * height).astype(int), n - 1)
        materials = [material("stable_neo_hookean", E=1.0 + k, nu=0.49) for k in range(n)]
        filled = [np.flatnonzero(layer == k).astype(np.int32) for k in range(n)]
        made[n] = Hessian(u, name, [Region(*pair) for pair in zip(materials, filled, strict=True)])
    calls: dict[str, Callable[[], Any]] = {
        str(n): partial(hessian.assemble, "clamp") for n, hessian in made.items()
    }
    times(calls, 1)
    taken = times(calls, repeat)
    for n in counts:
        ratio = float(np.median(taken[str(n)] / taken["1"]))
        yield {
            "element": name,
            "cells": domain.num_cells,
            "materials": n,
            "one_us": round(1e6 * float(taken["1"].min()) / domain.num_cells, 3),
            "several_us": round(1e6 * float(taken[str(n)].min()) / domain.num_cells, 3),
            "ratio": round(ratio, 3),
            "limit": LIMIT,
            "ok": bool(ratio <= LIMIT),
        }
