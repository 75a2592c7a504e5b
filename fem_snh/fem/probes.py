"""Displacements of fixed points of the reference body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.errors import BadInput

#: A point this far outside a cell, in parts of its size, is still in it.
_TOLERANCE = 1e-6


class Probes:
    """The displacement ``u`` (a dolfinx Function) at points that are located once. Collective.

    Parameters
    ----------
    probes : with ``name`` and ``point``, in reference coordinates [length].

    One rank has a point, and one of its cells, also where cells and ranks meet. Raises BadInput on
    every rank for a point outside the body.
    """

    def __init__(self, u: Any, probes: Sequence[Any]) -> None:
        self._u, self._comm = u, u.function_space.mesh.comm
        self._names = [probe.name for probe in probes]
        self._mine = []
        for number, probe in enumerate(probes):
            found = self._locate(probe)
            if found is not None:
                self._mine.append((number, *found))

    def _locate(self, probe: Any) -> tuple[Any, Any] | None:
        """On the one rank that has the point: its cell's nodes and their weights there."""
        V = self._u.function_space
        cell, place, beyond = _dolfinx.locate(V.mesh, np.array(probe.point, dtype=float))
        least, rank = self._comm.allreduce((beyond, self._comm.rank), op=MPI.MINLOC)
        if not least <= _TOLERANCE:
            raise BadInput(
                f"probe '{probe.name}': {list(probe.point)} is outside the body, which "
                f"{_extent(V.mesh)}"
            )
        if rank != self._comm.rank:
            return None
        return _dolfinx.node_dofs(V)[cell], _dolfinx.tabulate_values(V, place[None])[0]

    def values(self) -> dict[str, list[float]]:
        """The displacement [length] of each point by name, the same on every rank. Collective."""
        if not self._names:
            return {}
        self._u.x.scatter_forward()
        nodal = self._u.x.array.reshape(-1, 3)
        values = np.zeros((len(self._names), 3))
        for number, nodes, weights in self._mine:
            values[number] = weights @ nodal[nodes]
        total = self._comm.allreduce(values)
        return dict(zip(self._names, total.tolist(), strict=True))


def _extent(domain: Any) -> str:
    """In words, the box around the mesh. Collective."""
    boxes = np.array(domain.comm.allgather(_dolfinx.bounding_box(domain)))
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    sides = zip("xyz", low, high, strict=True)
    return "extends over " + ", ".join(f"{axis} = {a:.6g}..{b:.6g}" for axis, a, b in sides)
