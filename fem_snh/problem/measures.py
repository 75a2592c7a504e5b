"""Scalar measures of a body's state: volume ratio, smallest J."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.errors import BadInput

Array = npt.NDArray[Any]


def body_measures(
    comm: MPI.Intracomm,
    cell_fields: dict[str, Array],
    u: Array,
    parts: Mapping[str, Array] | None = None,
) -> dict[str, Any]:
    """Return measures of the whole body. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The communicator of the mesh.
    cell_fields : dict of arrays
        Volumes [m^3] and smallest J of this rank's cells.
    u : (n, components) array
        Displacement [m] of this rank's nodes.
    parts : mapping of arrays, optional
        Cells of parts of the body, as `Problem` takes them.

    Returns
    -------
    dict
        ``volume_ratio``, deformed over reference volume; ``min_J``, the smallest J at a quadrature
        point; ``min_cell_J``, the smallest mean of J over a cell; ``max_u``, the largest nodal
        displacement [m]; ``volumes``, the volume ratio of each part, if there are parts.
    """
    max_u = float(np.sqrt((u**2).sum(axis=1).max(initial=0.0)))
    cells: list[Any] = [slice(None), *(parts or {}).values()]
    volumes = [cell_fields[key] for key in ("deformed_volume", "volume")]
    deformed, rest = comm.allreduce(np.array([[v[c].sum() for c in cells] for v in volumes]))
    ratios = (deformed / rest).tolist()
    min_J = float(cell_fields["min_J"].min(initial=np.inf))
    mean_J = cell_fields["deformed_volume"] / cell_fields["volume"]
    min_cell_J = float(mean_J.min(initial=np.inf))
    found = {
        "volume_ratio": ratios[0],
        "min_J": float(comm.allreduce(min_J, op=MPI.MIN)),
        "min_cell_J": float(comm.allreduce(min_cell_J, op=MPI.MIN)),
        "max_u": float(comm.allreduce(max_u, op=MPI.MAX)),
    }
    return found | ({"volumes": dict(zip(parts, ratios[1:], strict=True))} if parts else {})


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
        """Its (3,) reference coordinates [m]."""


class Probes:
    """Evaluates a displacement at points, each located once, in one cell of one rank. Collective.

    Parameters
    ----------
    u : dolfinx Function
        The displacement.
    probes : sequence of ProbePoint
        The points.

    Raises
    ------
    BadInput
        On every rank, for a point outside the body.
    """

    def __init__(self, u: _dolfinx.Function, probes: Sequence[ProbePoint]) -> None:
        self._u, self._comm = u, u.function_space.mesh.comm
        self._names = [probe.name for probe in probes]
        self._local = []
        for number, probe in enumerate(probes):
            found = self._nodes_and_weights(probe)
            if found is not None:
                self._local.append((number, *found))

    def _nodes_and_weights(self, probe: ProbePoint) -> tuple[Any, Any] | None:
        """Return the nodes of the probe's cell and their basis values; None on other ranks."""
        V = self._u.function_space
        cell, xi, outside = _dolfinx.locate(V.mesh, np.array(probe.point, dtype=float))
        smallest, rank = self._comm.allreduce((outside, self._comm.rank), op=MPI.MINLOC)
        in_plane = V.mesh.geometry.dim == 3 or not any(probe.point[2:])
        if not smallest <= _TOLERANCE or not in_plane:
            raise BadInput(
                f"probe '{probe.name}': {list(probe.point)} is outside the body, which "
                f"{_extent(V.mesh)}"
            )
        if rank != self._comm.rank:
            return None
        return _dolfinx.node_dofs(V)[cell], _dolfinx.tabulate_values(V, xi[None])[0]

    def weights(self) -> list[tuple[Any, Any]]:
        """Return local nodes and their basis values, for each point in a cell of this rank."""
        return [(nodes, weights) for _, nodes, weights in self._local]

    def values(self) -> dict[str, list[float]]:
        """Return the displacement [m] of each point by name, the same on all ranks. Collective.

        It has three components, of which those that a mesh of two dimensions lacks are zero.
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
