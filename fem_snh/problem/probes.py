"""Probes: the displacement at given points of a body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.cell_search import locate
from fem_snh.errors import BadInput

#: Distance outside the reference cell up to which a point counts as inside: for rounding, and for
#: points that are given to six digits.
_TOLERANCE = 1e-6


class ProbePoint(Protocol):
    """A named point of the reference body."""

    @property
    def name(self) -> str:
        """The probe's name in the output."""

    @property
    def point(self) -> Sequence[float]:
        """The probe's (3,) reference coordinates [m]."""


class Probes:
    """Evaluates a displacement at points, each located once, in one cell of one rank. Collective.

    Parameters
    ----------
    u : dolfinx Function
        The displacement.
    probes : sequence of ProbePoint
        The points, with different names.

    Raises
    ------
    BadInput
        On every rank, for a point outside the body.
    """

    def __init__(self, u: _dolfinx.Function, probes: Sequence[ProbePoint]) -> None:
        V = u.function_space
        self._u, self._comm = u, V.mesh.comm
        self._names = [probe.name for probe in probes]
        self._local: list[tuple[int, Array, Array]] = []
        if not probes:
            return
        cells, xi, outside = locate(V.mesh, np.array([probe.point for probe in probes], float))
        weights = _dolfinx.tabulate_values(V, xi)
        for number, probe in enumerate(probes):
            own = float(outside[number]), self._comm.rank
            smallest, rank = self._comm.allreduce(own, op=MPI.MINLOC)
            in_plane = V.mesh.geometry.dim == 3 or not any(probe.point[2:])
            if not smallest <= _TOLERANCE or not in_plane:
                raise BadInput(
                    f"probe '{probe.name}': {list(probe.point)} is outside the body, which "
                    f"{_extent(V.mesh)}"
                )
            if rank == self._comm.rank:
                nodes = _dolfinx.node_dofs(V)[cells[number]]
                self._local.append((number, nodes, weights[number]))

    def weights(self) -> list[tuple[Any, Any]]:
        """Return (local nodes, basis values), (k,) each, of each point in a cell of this rank."""
        return [(nodes, weights) for _, nodes, weights in self._local]

    def values(self) -> dict[str, list[float]]:
        """Return the displacement [m] of each point by name, on all ranks. Collective.

        It always has three components; components that the kinematics lacks are zero.
        """
        if not self._names:
            return {}
        self._u.x.scatter_forward()
        components = _dolfinx.num_components(self._u.function_space)
        nodal = self._u.x.array.reshape(-1, components)
        values = np.zeros((len(self._names), 3))
        for number, nodes, weights in self._local:
            values[number, :components] = weights @ nodal[nodes]
        total = self._comm.allreduce(values)
        return dict(zip(self._names, total.tolist(), strict=True))


def _extent(domain: _dolfinx.Mesh) -> str:
    """Return "extends over x = a..b, ...": the mesh's bounding box. Collective."""
    boxes = np.array(domain.comm.allgather(_dolfinx.bounding_box(domain)))
    low, high = boxes[:, 0].min(axis=0), boxes[:, 1].max(axis=0)
    sides = zip("xyz", low, high, strict=True)
    return "extends over " + ", ".join(f"{axis} = {a:.6g}..{b:.6g}" for axis, a, b in sides)
