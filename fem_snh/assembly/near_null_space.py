"""The near null space of an elastic stiffness matrix, which multigrid and deflation need."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np


def rigid_motions(
    comm: MPI.Intracomm, coordinates: np.ndarray, free: np.ndarray
) -> PETSc.NullSpace:
    """Return the six rigid motions of a displacement, orthonormal. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The communicator of the mesh.
    coordinates : (n, 3) array
        Reference coordinates of the nodes that this rank owns.
    free : (n, 3) array
        0 for constrained components, where the motions are set to zero; else 1.
    """
    basis = []
    for axis in np.eye(3):
        for motion in (np.tile(axis, (len(coordinates), 1)), np.cross(axis, coordinates)):
            vector = PETSc.Vec().createMPI((coordinates.size, None), bsize=3, comm=comm)
            vector.array[:] = (motion * free).ravel()
            basis.append(vector)
    for i, vector in enumerate(basis):
        for other in basis[:i]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    return PETSc.NullSpace().create(vectors=basis, comm=comm)
