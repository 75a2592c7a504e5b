"""Scalar measures of a body's state: volume ratio, smallest J."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

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
