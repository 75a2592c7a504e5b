"""A body's size, shape and contrasts, by which a solver chooses defaults; paths of stiff parts."""

from __future__ import annotations

from collections.abc import Sequence
from math import isfinite
from typing import TYPE_CHECKING

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh._petsc import vector_like
from fem_snh.arrays import Array
from fem_snh.assembly.connected_parts import connected_parts
from fem_snh.assembly.elements import Element
from fem_snh.assembly.regions import Region
from fem_snh.errors import bad_value
from fem_snh.geometry.rotations import nearest_rotation, rotate
from fem_snh.solver.protocol import Regime
from fem_snh.terms.elastic import Part
from fem_snh.terms.term import Term

if TYPE_CHECKING:
    from fem_snh.problem.problem import Problem
    from fem_snh.terms.rigid_parts import RigidParts


#: Number of equal sections of the longest axis that `supported` examines for constrained nodes.
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
        Which of this rank's own nodes have a constrained component.
    """
    tables = [part.loops.tables for part in parts]
    cells = np.concatenate([table.x[table.geometry] for table in tables] or [np.empty((0, 1, 3))])
    materials = [part.region.material for part in parts]
    shear = [float(material.lame[0]) for material in materials]
    return Regime(
        comm.allreduce(len(coordinates)),
        element.kinematics.dim,
        element.degree,
        section_nodes(comm, coordinates, cells, element.degree),
        max((material.numbers.nu for material in materials), default=0.0),
        any(term.name == "inertia" for term in terms),
        cell_aspect(comm, cells[..., : element.kinematics.dim]),
        supported(comm, coordinates, constrained),
        float(comm.allreduce(constrained.sum()) / max(1, comm.allreduce(len(constrained)))),
        max(shear) / min(shear) if shear else 1.0,
        any(term.has_penalties for term in terms),
    )


def section_nodes(comm: MPI.Comm, nodes: Array, cells: Array, degree: int) -> float:
    r"""Return the mean number of nodes in a section across a body's longest axis. Collective.

    The axis is the principal axis of the nodes with the largest variance :math:`\lambda_{\max}`. A
    bar with this variance has the length :math:`L = \sqrt{12 \lambda_{\max}}`. The distance of
    neighbouring sections is a cell's extent along the axis over the degree. The extent is twice the
    standard deviation of the cell's corners, which for a cube is the same in every direction.

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
        The mean number; inf without cells of a material.
    """
    count, length, axis = _longest_axis(comm, nodes)
    extents = 2 * np.std(cells @ axis, axis=1)
    total, number = comm.allreduce(np.array([extents.sum(), len(extents)]))
    if not number:
        return float("inf")
    return float(count * total / (number * degree * length)) if length > 0 else float(count)


def cell_aspect(comm: MPI.Comm, cells: Array) -> float:
    """Return the mean over the cells of largest to smallest extent; 1 without cells. Collective.

    The extents are the standard deviations of the corners along their principal axes, the same in
    every direction for a cube and for a regular tetrahedron. ``cells`` (cells, corners, dim) are
    the corners of this rank's cells [m].
    """
    centred = cells - cells.mean(axis=1, keepdims=True)
    squares = np.linalg.eigvalsh(np.einsum("cki,ckj->cij", centred, centred))
    largest = squares[:, -1]
    ratios = np.sqrt(largest / np.maximum(squares[:, 0], np.finfo(float).eps * largest))
    total, number = comm.allreduce(np.array([ratios.sum(), len(ratios)]))
    return float(total / number) if number else 1.0


def supported(comm: MPI.Comm, nodes: Array, constrained: Array) -> float:
    """Return the part of the longest axis along which nodes are constrained, 0 to 1. Collective.

    ``nodes`` (n, 3) are the coordinates [m] of this rank's own nodes; ``constrained`` (n,) bool
    tells which of them are constrained.
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
    """Return the number of nodes, the length L [m] of `section_nodes`, and the axis (3,).

    Collective.
    """
    count, *first = comm.allreduce(np.concatenate([[len(nodes)], nodes.sum(axis=0)]))
    centred = nodes - np.array(first) / count
    moments, axes = np.linalg.eigh(comm.allreduce(centred.T @ centred) / count)
    return int(count), float(np.sqrt(12 * max(0.0, moments[-1]))), axes[:, -1]


#: Strain of the central difference in `_curvature`: about the cube root of the rounding error.
_STRAIN = 1e-5


def set_modulus(problem: Problem) -> None:
    """Set ``modulus`` and ``force_scale`` of a problem without materials. Collective.

    The modulus is 3 times the shear modulus (E of an incompressible material), the least curvature
    of the energy at ``problem.x`` in uniform shears. If nothing resists shear, as with springs
    alone, it is the mean entry on the Hessian's diagonal over the distance of nodes, of the same
    unit.

    Raises
    ------
    BadInput
        If the curvature is negative in all shears and in a dilation, as with residuals of the wrong
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
    """Return the second derivative by g of the energy at u = g G X, per volume [Pa]. Collective.

    G is ``gradient``, (components, 3).
    """
    moved = vector_like(problem.x, (problem.coordinates @ gradient.T).ravel())
    works = []
    for sign in (1, -1):
        state = problem.x.copy()
        state.axpy(sign * _STRAIN, moved)
        works.append(float(problem.gradient_at(state).dot(moved)))
    volume = problem.length**problem.kinematics.volume_dimension
    return (works[0] - works[1]) / (2 * _STRAIN * volume)


#: A part is stiff from this shear modulus on, relative to the body's smallest: below, its
#: linearised rotation costs no iterations (measured: python -m benchmarks contrast).
_STIFF = 1e3
#: Weight of constrained nodes in the rigid motion of a part: free nodes decide only what the
#: constrained nodes leave open, such as the angle about a hinge.
_HELD = 1e6


class StiffParts:
    """The connected stiff parts of a body, which rotate along steps. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    X : (n, 3)
        Coordinates [m] of this rank's own nodes.
    labels : (n,) int
        The part of each of the n nodes; -1 for nodes in no part.
    count : int
        The number of parts on all ranks.
    fixed : (n, 3) bool
        The constrained components of the n nodes.
    """

    def __init__(self, comm: MPI.Comm, X: Array, labels: Array, count: int, fixed: Array) -> None:
        self._comm, self._count = comm, count
        nodes = np.flatnonzero(labels >= 0)
        self._labels, self._X, self._fixed = labels[nodes], X[nodes], fixed[nodes]
        self._dofs = 3 * nodes[:, None] + np.arange(3)
        self._weights = np.where(self._fixed.any(axis=1, keepdims=True), _HELD, 1.0)
        self._size = self._sum(np.ones((len(nodes), 1)))

    @classmethod
    def of(
        cls, V: _dolfinx.FunctionSpace, regions: Sequence[Region], fixed: Array, excluded: Array
    ) -> StiffParts | None:
        """Return the stiff parts of a body; None without any, or on a plane mesh. Collective.

        Parameters
        ----------
        V : dolfinx function space
            The displacement's space.
        regions : sequence of Region
            The materials and their cells.
        fixed : (n, 3) bool
            The constrained components of this rank's own nodes.
        excluded : (n,) bool
            Which of the n nodes are constrained otherwise. Parts with such nodes are left out.
        """
        comm = V.mesh.comm
        shear = [float(region.material.lame[0]) for region in regions]
        stiff = [r for r, mu in zip(regions, shear, strict=True) if mu >= _STIFF * min(shear)]
        if not stiff or _dolfinx.mesh_dimension(V.mesh)[0] != 3:
            return None
        part, count = connected_parts(V, np.concatenate([region.cells for region in stiff]))
        part = part[: len(excluded)]
        held = comm.allreduce(np.bincount(part[excluded & (part >= 0)], minlength=count)) > 0
        if held.all():
            return None
        number = np.where(held, -1, np.cumsum(~held) - 1)
        labels = np.append(number, -1)[part]
        X = V.tabulate_dof_coordinates()[: len(excluded)]
        return cls(comm, X, labels, int((~held).sum()), fixed)

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set ``end`` to x + step d, with finite rotations of the stiff parts. Collective."""
        end.waxpy(step, d, x)
        (middle, r), (mean, v) = self._centred(
            self._X + x.array_r[self._dofs], step * d.array_r[self._dofs]
        )
        squares = (r**2).sum(axis=1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
        sums = self._sum(np.hstack([squares.reshape(-1, 9), np.cross(r, v)]))
        omega = np.linalg.solve(sums[:, :9].reshape(-1, 3, 3), sums[:, 9:, None])
        omega = omega[self._labels, :, 0]
        self._place(end, middle + mean + rotate(omega, r + v - np.cross(omega, r)))

    def move_rigidly(self, start: PETSc.Vec, x: PETSc.Vec) -> None:
        """Replace each part's motion from ``start`` to ``x`` by the nearest rigid one, in ``x``.

        Collective.
        """
        ends = (self._X + vector.array_r[self._dofs] for vector in (start, x))
        (_, r), (mean, s) = self._centred(*ends)
        H = self._sum((s[:, :, None] * r[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        self._place(x, mean + np.einsum("nij,nj->ni", nearest_rotation(H)[self._labels], r))

    def _centred(self, *values: Array) -> list[tuple[Array, Array]]:
        """Return the mean of each part at its nodes, and the rest, of two (nodes, 3) arrays."""
        means = (self._sum(np.hstack(values)) / self._size)[self._labels]
        return [(m, v - m) for v, m in zip(values, np.hsplit(means, 2), strict=True)]

    def _place(self, x: PETSc.Vec, positions: Array) -> None:
        """Set the displacements in ``x`` that are not fixed to those of positions (nodes, 3)."""
        u = x.array
        u[self._dofs] = np.where(self._fixed, u[self._dofs], positions - self._X)

    def _sum(self, values: Array) -> Array:
        """Return weighted sums of (nodes, columns) over each part, (parts, columns). Collective."""
        sums = np.zeros((self._count, values.shape[1]))
        np.add.at(sums, self._labels, self._weights * values)
        return np.asarray(self._comm.allreduce(sums))


class Paths:
    """The curved paths of nodes along a step of Newton's method: stiff and rigid parts rotate.

    All methods are collective.

    Parameters
    ----------
    stiff : StiffParts or None
    rigid : RigidParts or None

    Attributes
    ----------
    exact : bool
        Whether a step must end on its path: a straight step would deform rigid parts. Otherwise a
        straight step may replace it.
    """

    def __init__(self, stiff: StiffParts | None, rigid: RigidParts | None) -> None:
        self._stiff, self._rigid, self.exact = stiff, rigid, rigid is not None

    @classmethod
    def of(
        cls,
        V: _dolfinx.FunctionSpace,
        regions: Sequence[Region],
        fixed: Array,
        excluded: Array,
        rigid: RigidParts | None,
    ) -> Paths | None:
        """Return the paths of a problem; None if all are straight. Collective.

        All parameters but ``rigid`` are those of `StiffParts.of`.
        """
        stiff = StiffParts.of(V, regions, fixed, excluded)
        return cls(stiff, rigid) if stiff or rigid else None

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set ``end`` to the point at length ``step`` of the path from x along d. Collective."""
        if self._stiff:
            self._stiff(x, d, step, end)
        else:
            end.waxpy(step, d, x)
        if self._rigid:
            self._rigid.move(x, d, step, end)

    def move_rigidly(self, start: PETSc.Vec, x: PETSc.Vec) -> None:
        """Replace the motion of stiff and rigid parts by the nearest rigid one, in ``x``."""
        if self._stiff:
            self._stiff.move_rigidly(start, x)
        if self._rigid:
            self._rigid.move_rigidly(x)
