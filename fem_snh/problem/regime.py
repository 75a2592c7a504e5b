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

#: Equal parts of the longest axis of which `supported` tells whether a node in them is constrained.
_PARTS = 20


def regime_of(
    comm: MPI.Comm,
    coordinates: Array,
    element: Element,
    parts: Sequence[Part],
    terms: Sequence[Term],
    constrained: Array,
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
    constrained : (n,) bool
        Which of these nodes have a constrained component.
    """
    tables = [part.loops.tables for part in parts]
    cells = np.concatenate([table.x[table.geometry] for table in tables] or [np.empty((0, 1, 3))])
    moduli = [part.region.material.lame for part in parts]
    shear = [float(mu) for mu, _ in moduli]
    return Regime(
        comm.allreduce(len(coordinates)),
        element.kinematics.dim,
        element.degree,
        section_nodes(comm, coordinates, cells, element.degree),
        max((float(lam / (2 * (lam + mu))) for mu, lam in moduli), default=0.0),
        any(term.name == "inertia" for term in terms),
        cell_aspect(comm, cells[..., : element.kinematics.dim]),
        supported(comm, coordinates, constrained),
        float(comm.allreduce(constrained.sum()) / max(1, comm.allreduce(len(constrained)))),
        max(shear) / min(shear) if shear else 1.0,
        any(term.has_penalties for term in terms),
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
    count, length, axis = _longest_axis(comm, nodes)
    extents = 2 * np.std(cells @ axis, axis=1)
    total, number = comm.allreduce(np.array([extents.sum(), len(extents)]))
    if not number:
        return float("inf")
    return float(count * total / (number * degree * length)) if length > 0 else float(count)


def cell_aspect(comm: MPI.Comm, cells: Array) -> float:
    """Return the mean ratio of the cells' largest to their smallest extents. Collective.

    The extents are the standard deviations of the corners along their principal axes, the same in
    every direction for a cube and for a regular tetrahedron. ``cells``, of shape
    (cells, corners, dim), are those of this rank [m].
    """
    centred = cells - cells.mean(axis=1, keepdims=True)
    squares = np.linalg.eigvalsh(np.einsum("cki,ckj->cij", centred, centred))
    largest = squares[:, -1]
    ratios = np.sqrt(largest / np.maximum(squares[:, 0], np.finfo(float).eps * largest))
    total, number = comm.allreduce(np.array([ratios.sum(), len(ratios)]))
    return float(total / number) if number else 1.0


def supported(comm: MPI.Comm, nodes: Array, constrained: Array) -> float:
    """Return the part of the longest axis along which nodes are constrained. Collective.

    ``nodes``, of shape (n, 3), are this rank's own [m], of which ``constrained``, (n,) bool, are
    constrained.
    """
    along = nodes @ _longest_axis(comm, nodes)[2]
    low = comm.allreduce(along.min(initial=np.inf), op=MPI.MIN)
    extent = comm.allreduce(along.max(initial=-np.inf), op=MPI.MAX) - low
    if not extent > 0:
        return 1.0
    parts = np.minimum((along[constrained] - low) * (_PARTS / extent), _PARTS - 1).astype(int)
    held = comm.allreduce(np.bincount(parts, minlength=_PARTS))
    return float((held > 0).mean())


def _longest_axis(comm: MPI.Comm, nodes: Array) -> tuple[int, float, Array]:
    """Return the number of nodes, the length [m] of their longest axis, and its direction, (3,)."""
    count, *first = comm.allreduce(np.concatenate([[len(nodes)], nodes.sum(axis=0)]))
    centred = nodes - np.array(first) / count
    moments, axes = np.linalg.eigh(comm.allreduce(centred.T @ centred) / count)
    return int(count), float(np.sqrt(12 * max(0.0, moments[-1]))), axes[:, -1]
