"""Size, shape and Poisson's ratio of a body: what a solver chooses its defaults by."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.elements import Element
from fem_snh.solver.protocol import Regime
from fem_snh.terms.elastic import Part
from fem_snh.terms.term import Term

Array = npt.NDArray[Any]


def regime_of(
    comm: MPI.Comm,
    coordinates: Array,
    element: Element,
    parts: Sequence[Part],
    terms: Sequence[Term],
) -> Regime:
    """Return the regime of a problem. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    coordinates : (n, 3)
        Coordinates [m] of this rank's own nodes.
    element : Element
        The element.
    parts : sequence of Part
        The body's materials and cells.
    terms : sequence of Term
        The problem's terms.
    """
    tables = [part.loops.tables for part in parts]
    cells = [table.x[table.geometry] for table in tables] or [np.empty((0, 1, 3))]
    moduli = [part.region.material.lame for part in parts]
    return Regime(
        comm.allreduce(len(coordinates)),
        element.kinematics.dim,
        section_nodes(comm, coordinates, np.concatenate(cells), element.degree),
        max((float(lam / (2 * (lam + mu))) for mu, lam in moduli), default=0.0),
        any(term.name == "inertia" for term in terms),
    )


def section_nodes(comm: MPI.Comm, nodes: Array, cells: Array, degree: int) -> float:
    r"""Return the mean number of nodes in a section across a body's longest axis. Collective.

    The axis is the principal one of the nodes; the length :math:`L = \sqrt{12 \lambda_{\max}}` is
    that of a bar with this moment. Sections through neighbouring nodes are a cell's extent along
    the axis over its degree apart. The extent is twice the standard deviation of the cell's
    corners, which for a cube is the same in every direction.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    nodes : (n, 3)
        Coordinates [m] of this rank's own nodes.
    cells : (cells, corners, 3)
        Coordinates [m] of the corners of this rank's cells.
    degree : int
        Degree of the displacement.

    Returns
    -------
    float
        The number; infinity without cells of a material.
    """
    count, *first = comm.allreduce(np.concatenate([[len(nodes)], nodes.sum(axis=0)]))
    centred = nodes - np.array(first) / count
    moments, axes = np.linalg.eigh(comm.allreduce(centred.T @ centred) / count)
    length, axis = np.sqrt(12 * max(0.0, moments[-1])), axes[:, -1]
    extents = 2 * np.std(cells @ axis, axis=1)
    total, number = comm.allreduce(np.array([extents.sum(), len(extents)]))
    if not number:
        return float("inf")
    return float(count * total / (number * degree * length)) if length > 0 else float(count)
