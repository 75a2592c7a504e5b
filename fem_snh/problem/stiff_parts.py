r"""Steps along which stiff parts of a body turn, instead of growing.

A step d of Newton's method turns a stiff part by a linearised rotation, :math:`\omega \times r`,
which lengthens it by :math:`|\omega|^2 / 2`. Where the part is c times as stiff as its
surroundings, that costs an energy in proportion to :math:`c\, |\omega|^4`, and shortens every step.
So the nodes of each connected stiff part move along

.. math:: y(s) = \bar y + s \bar d + \exp(s [\omega]_\times) (r + s d_\mathrm{def}), \qquad
          d = \bar d + \omega \times r + d_\mathrm{def},

with the mean :math:`\bar y`, :math:`r = y - \bar y` and the :math:`\omega` of the smallest
:math:`d_\mathrm{def}`. The slope at s = 0 is that of x + s d (a retraction; Absil, Mahony &
Sepulchre 2008, section 4.1). A first guess moves each part as a rigid body (Kabsch 1976). In a part
with constrained nodes these have a large weight in means and rotations: it turns about them, and
follows their motion. What is constrained of them stays on its straight way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.regions import Region
from fem_snh.geometry.rotations import nearest_rotation, rotate

if TYPE_CHECKING:
    from fem_snh.terms.rigid_parts import RigidParts


Array = npt.NDArray[Any]

#: A part is stiff from this shear modulus on, relative to the smallest one: below, its linearised
#: rotation costs no iterations (measured: python -m benchmarks contrast).
_STIFF = 1e3
#: Weight of constrained nodes: the others decide only on what these leave open, such as the angle
#: about a hinge.
_HELD = 1e6


class StiffParts:
    """The connected stiff parts of a body. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    X : (n, 3)
        Coordinates [m] of this rank's own nodes.
    labels : (n,) int
        The part of each of these nodes; -1 without one.
    count : int
        The number of parts.
    fixed : (n, 3) bool
        The constrained components of these nodes.
    """

    def __init__(self, comm: MPI.Comm, X: Array, labels: Array, count: int, fixed: Array) -> None:
        self._comm, self._count = comm, count
        self._nodes = np.flatnonzero(labels >= 0)
        self._labels, self._X = labels[self._nodes], X[self._nodes]
        self._fixed = fixed[self._nodes]
        self._weights = np.where(self._fixed.any(axis=1, keepdims=True), _HELD, 1.0)
        self._size = self._sum(np.ones((len(self._nodes), 1)))

    @classmethod
    def of(
        cls, V: Any, regions: Sequence[Region], fixed: Array, excluded: Array
    ) -> StiffParts | None:
        """Return the stiff parts of a body of three dimensions; None if there is none. Collective.

        Parameters
        ----------
        V : dolfinx function space
            The displacement's space.
        regions : sequence of Region
            The materials and their cells.
        fixed : (n, 3) bool
            The constrained components of this rank's own nodes.
        excluded : (n,) bool
            Which of them are constrained otherwise; parts that have some are left out.
        """
        comm = V.mesh.comm
        shear = [float(region.material.lame[0]) for region in regions]
        stiff = [r for r, mu in zip(regions, shear, strict=True) if mu >= _STIFF * min(shear)]
        if not stiff or _dolfinx.mesh_dimension(V.mesh)[0] != 3:
            return None
        cells = np.concatenate([region.cells for region in stiff])
        to_global = _dolfinx.local_to_global(V)
        nodes = to_global[_dolfinx.node_dofs(V)[cells]]
        owned = to_global[: len(excluded)]
        every, of = np.unique(np.concatenate(comm.allgather(nodes)), return_inverse=True)
        roots = components(of.reshape(-1, nodes.shape[1]), len(every))
        others = np.concatenate(comm.allgather(owned[excluded]))
        free = np.setdiff1d(roots, roots[np.isin(every, others)])
        labels = np.full(len(excluded), -1)
        at = np.minimum(np.searchsorted(every, owned), len(every) - 1)
        part = np.minimum(np.searchsorted(free, roots[at]), max(0, len(free) - 1))
        if not len(free):
            return None
        inside = (every[at] == owned) & (free[part] == roots[at])
        labels[inside] = part[inside]
        X = V.tabulate_dof_coordinates()[: len(excluded)]
        return cls(comm, X, labels, len(free), fixed)

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set ``end`` to x + step d, with stiff parts that turn. Collective."""
        end.waxpy(step, d, x)
        nodes, labels, shape = self._nodes, self._labels, (-1, 3)
        y = self._X + x.array_r[: 3 * self._total(x)].reshape(shape)[nodes]
        v = step * d.array_r[: 3 * self._total(x)].reshape(shape)[nodes]
        means = self._sum(np.hstack([y, v])) / self._size
        r, v = y - means[labels, :3], v - means[labels, 3:]
        squares = (r**2).sum(axis=1)[:, None, None] * np.eye(3) - r[:, :, None] * r[:, None, :]
        sums = self._sum(np.hstack([squares.reshape(-1, 9), np.cross(r, v)]))
        omega = np.linalg.solve(sums[:, :9].reshape(-1, 3, 3), sums[:, 9:, None])[:, :, 0]
        turned = rotate(omega[labels], r + v - np.cross(omega[labels], r))
        values = end.array
        moved = values[: 3 * self._total(x)].reshape(shape)
        turned = means[labels, :3] + means[labels, 3:] + turned - self._X
        moved[nodes] = np.where(self._fixed, moved[nodes], turned)

    def move_rigidly(self, start: PETSc.Vec, x: PETSc.Vec) -> None:
        """Make each part's motion from ``start`` to ``x`` the nearest rigid one. Collective."""
        total = 3 * self._total(x)
        y, z = (self._X + v.array_r[:total].reshape(-1, 3)[self._nodes] for v in (start, x))
        means = self._sum(np.hstack([y, z])) / self._size
        r, s = y - means[self._labels, :3], z - means[self._labels, 3:]
        H = self._sum((s[:, :, None] * r[:, None, :]).reshape(-1, 9)).reshape(-1, 3, 3)
        turned = np.einsum("nij,nj->ni", nearest_rotation(H)[self._labels], r)
        moved = x.array[:total].reshape(-1, 3)
        turned = means[self._labels, 3:] + turned - self._X
        moved[self._nodes] = np.where(self._fixed, moved[self._nodes], turned)

    def _total(self, x: PETSc.Vec) -> int:
        """Return a number of nodes that contains those of all parts."""
        return int(self._nodes[-1]) + 1 if len(self._nodes) else 0

    def _sum(self, values: Array) -> Array:
        """Return weighted sums over each part's nodes, (parts, columns), of (nodes, columns)."""
        sums = np.zeros((self._count, values.shape[1]))
        np.add.at(sums, self._labels, self._weights * values)
        return np.asarray(self._comm.allreduce(sums))


def components(cells: Array, count: int) -> Array:
    """Return the smallest node of the connected part of each of ``count`` nodes of ``cells``."""
    roots = np.arange(count)
    if not cells.size:
        return roots
    order = np.argsort(cells, axis=None, kind="stable")
    sorted_nodes, cell_of = cells.ravel()[order], order // cells.shape[1]
    starts = np.flatnonzero(np.diff(sorted_nodes, prepend=-1))
    nodes = sorted_nodes[starts]
    while True:
        smallest = roots[cells].min(axis=1)[cell_of]
        before = roots.copy()
        roots[nodes] = np.minimum(roots[nodes], np.minimum.reduceat(smallest, starts))
        roots = roots[roots]
        if np.array_equal(roots, before):
            return roots


class Paths:
    """The paths of all nodes: of stiff parts, of rigid parts, and straight ones. Collective.

    Parameters
    ----------
    stiff : StiffParts or None
    rigid : RigidParts or None

    Attributes
    ----------
    exact : bool
        Whether steps must end on the path: a straight step would deform rigid parts.
    """

    def __init__(self, stiff: StiffParts | None, rigid: RigidParts | None) -> None:
        self._stiff, self._rigid, self.exact = stiff, rigid, rigid is not None

    @classmethod
    def of(
        cls,
        V: Any,
        regions: Sequence[Region],
        fixed: npt.NDArray[np.bool_],
        excluded: npt.NDArray[np.bool_],
        rigid: RigidParts | None,
    ) -> Paths | None:
        """Return the paths of a problem; None if all are straight. Collective.

        The first parameters are those of `StiffParts.of`.
        """
        stiff = StiffParts.of(V, regions, fixed, excluded)
        return cls(stiff, rigid) if stiff or rigid else None

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set ``end`` to the end of the path from x along step d."""
        if self._stiff:
            self._stiff(x, d, step, end)
        else:
            end.waxpy(step, d, x)
        if self._rigid:
            self._rigid.move(x, d, step, end)

    def move_rigidly(self, start: PETSc.Vec, x: PETSc.Vec) -> None:
        """Replace the motion of stiff and rigid parts by the nearest rigid one, in place."""
        if self._stiff:
            self._stiff.move_rigidly(start, x)
        if self._rigid:
            self._rigid.move_rigidly(x)
