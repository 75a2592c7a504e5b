r"""Linear displacements of the whole body, solved for exactly and in double precision.

A stiff body that only inertia or soft springs keep moves as a rigid one. With nodes of mass m and
stiffness k and the time step h, the Rayleigh quotients of the rigid motions are of the order of
:math:`m / (k h^2)` of the largest: 1e-8 for steel, cells of 0.2 mm and steps of 0.5 ms. A matrix in
single precision does not have them, as its entries are rounded to 1e-7. With the columns of Z, the
displacements linear in the reference coordinates, which contain the rigid motions of a body in any
deformed state,

.. math:: x \mathrel{+}= Z (Z^T A Z)^{-1} Z^T (b - A x)

leaves a residual orthogonal to them: the rest of the solution is elastic, for which single
precision is enough.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.linalg.coarse_space import RANK_TOLERANCE
from fem_snh.linalg.ssor_system import LEAST_IN_DOUBLE

Array = npt.NDArray[Any]


class BodyModes:
    """The linear displacements of a body whose matrix is A. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        The matrix.
    coordinates : (rows, dim)
        Reference coordinates of this rank's nodes.
    free : (rows, components) bool
        Which displacements are coupled to others; the rest is prescribed.
    scale : float
        One over the largest diagonal entry of A.
    """

    def __init__(self, A: PETSc.Mat, coordinates: Array, free: Array, scale: float) -> None:
        self._comm = A.comm.tompi4py()
        x, y = A.createVecs()
        images = []
        self._Z = _linear(self._comm, coordinates, free)
        for column in self._Z.T:
            x.array[:] = column
            A.mult(x, y)
            images.append(y.array.copy())
        for vector in (x, y):
            vector.destroy()
        self._AZ = np.column_stack(images)
        values, vectors = np.linalg.eigh(scale * self._comm.allreduce(self._Z.T @ self._AZ))
        # Z^T A Z is rounded, too: what it has not in double precision is left to the iterations.
        known = values > LEAST_IN_DOUBLE
        self._inverse = scale * (vectors[:, known] / values[known]) @ vectors[:, known].T

    def correct(self, x: PETSc.Vec, residual: PETSc.Vec) -> None:
        """Add the correction to x, and update its residual b - A x. Collective."""
        y = self._inverse @ self._comm.allreduce(self._Z.T @ residual.array_r)
        x.array[:] += self._Z @ y
        residual.array[:] -= self._AZ @ y


def _linear(comm: Any, coordinates: Array, free: Array) -> Array:
    """Return orthonormal columns, (rows components, columns): functions 1 and X of each component.

    Those that the free nodes do not distinguish from others are left out.
    """
    count, first = comm.allreduce(np.array([len(coordinates)])), coordinates.sum(axis=0)
    X = coordinates - comm.allreduce(first) / count
    size = np.sqrt(comm.allreduce(float((X**2).sum())) / count)
    functions = np.column_stack([np.ones(len(X)), X / size])
    columns = []
    for component in range(free.shape[1]):
        here = functions * free[:, component, None]
        values, vectors = np.linalg.eigh(comm.allreduce(here.T @ here))
        kept = values > RANK_TOLERANCE**2 * values[-1]
        for column in (here @ (vectors[:, kept] / np.sqrt(values[kept]))).T:
            Z = np.zeros(free.shape)
            Z[:, component] = column
            columns.append(Z.ravel())
    return np.column_stack(columns)
