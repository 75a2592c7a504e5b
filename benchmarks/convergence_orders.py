"""Orders of convergence and locking: errors of a manufactured solution, mesh by mesh."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from math import log

from benchmarks import Row, split_list
from benchmarks.manufactured import Manufactured
from fem_snh.assembly.elements import ELEMENTS, element
from fem_snh.errors import BadInput

#: Cells along the edge of the cube, by the degree of the displacement.
CELLS = {1: "4,8,12", 2: "3,6,9"}
NAMES = ("L2", "H1", "pressure")


def rows(
    elements: str = "",
    nus: str = "0.3,0.4999,0.5",
    cells: str = "",
    shear: float = 0.1,
    swell: float = 0.1,
) -> Iterator[Row]:
    """Yield one row per element and nu; nu = 0.5 for Taylor-Hood elements only.

    Parameters
    ----------
    shear, swell : float
        See `Manufactured`; swell = 0 is the same displacement at every nu, with J = 1.

    Yields
    ------
    dict
        ``L2``, ``H1``, ``pressure``: the errors ||u - u_h||, ||grad(u - u_h)||, ||p - p_h||;
        ``orders``: their orders from mesh to mesh.
    """
    for name in split_list(elements) or ELEMENTS:
        kind = element(name)
        meshes = [int(n) for n in split_list(cells or CELLS[kind.degree])]
        for nu in map(float, split_list(nus)):
            if nu < 0.5 or kind.volume == "pressure":
                yield {"element": name, "nu": nu} | _errors(name, meshes, nu, shear, swell)


def _errors(name: str, meshes: list[int], nu: float, shear: float, swell: float) -> Row:
    found, newton = [], []
    for n in meshes:
        problem = Manufactured(element(name), n, nu, shear, swell)
        try:
            newton.append(problem.solve())
        except BadInput as error:
            return {"cells": meshes, "ok": False, "reason": str(error)}
        found.append(problem.errors())
    columns = dict(zip(NAMES, map(list, zip(*found, strict=True)), strict=False))
    orders = {key: _orders(meshes, errors) for key, errors in columns.items()}
    return {"cells": meshes, "newton": newton, **columns, "orders": orders, "ok": True}


def _orders(meshes: list[int], errors: list[float]) -> list[float]:
    """Return the slopes of log error over log h from mesh to mesh."""
    pairs = pairwise(zip(meshes, errors, strict=True))
    return [round(log(a / b) / log(fine / coarse), 3) for (coarse, a), (fine, b) in pairs]
