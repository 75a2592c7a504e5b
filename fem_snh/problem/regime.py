"""Size, shape and Poisson's ratio of a body: what a solver chooses its defaults by."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING, Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.elements import Element
from fem_snh.errors import bad_value
from fem_snh.solver.protocol import Regime
from fem_snh.terms.elastic import Part
from fem_snh.terms.term import Term

if TYPE_CHECKING:
    from fem_snh.problem.problem import Problem

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


#: Strain of the central difference in `_curvature`: about the cube root of the rounding error.
_STRAIN = 1e-5


def set_modulus(problem: Problem) -> None:
    """Set the moduli of a problem without materials, from its terms at the start.

    That of forces is 3 times the shear modulus, E of an incompressible material: the least
    curvature of the energy in three uniform shears. Without resistance to shear, as of springs, it
    is the mean entry on the Hessian's diagonal over the nodes' distance, which has the same unit.

    Raises
    ------
    BadInput
        If the curvature is negative in the shears and in a dilation: of residuals with the other
        sign, which a solver of equations does not notice.
    """
    dim, components = problem.kinematics.dim, problem.kinematics.components
    gradients = np.zeros((dim + 1, components, 3))
    for i in range(dim):
        gradients[i, i, (i + 1) % dim] = 1.0  # u_i = g X_j
    gradients[dim] = np.eye(components, 3)
    *shears, dilation = [_curvature(problem, gradient) for gradient in gradients]
    if max(*shears, dilation) < 0:
        accepted = "energies, or residuals that are their derivatives: the stiffness is negative "
        accepted += "in shear and in dilation; multiply the forms by -1"
        raise bad_value("terms", "forms of the other sign", accepted)
    modulus = 3 * min(shears)
    if not (isfinite(modulus) and modulus > 0):
        problem.jacobian(problem.x, "clamp")
        distance = problem.length * (problem.dofs / components) ** (-1 / dim)
        modulus = (problem.matrix.constrained_diagonal or 1.0) / distance
    volume_dimension = problem.kinematics.volume_dimension
    problem.modulus = modulus
    problem.force_scale = modulus * problem.length ** (volume_dimension - 1)


def _curvature(problem: Problem, gradient: Array) -> float:
    """The second derivative of the energy in u = g G X by g, per volume [Pa]. Collective."""
    force, moved = problem.x.duplicate(), problem.x.duplicate()
    moved.set(0.0)
    moved.array[: problem.owned_displacements] = (problem.coordinates @ gradient.T).ravel()
    works = []
    for sign in (1, -1):
        state = problem.x.copy()
        state.axpy(sign * _STRAIN, moved)
        problem.gradient(state, force)
        works.append(float(force.dot(moved)))
    volume = problem.length**problem.kinematics.volume_dimension
    return (works[0] - works[1]) / (2 * _STRAIN * volume)
