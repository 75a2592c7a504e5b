"""The near null space of an elastic stiffness matrix, which multigrid and deflation need."""

from __future__ import annotations

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh.assembly.kinematics import SOLID, Kinematics


def rigid_motions(
    comm: MPI.Intracomm,
    coordinates: np.ndarray,
    free: np.ndarray,
    kinematics: Kinematics = SOLID,
) -> PETSc.NullSpace:
    """Return the rigid motions of a displacement, orthonormal. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The communicator of the mesh.
    coordinates : (n, 3) array
        Reference coordinates of the nodes that this rank owns.
    free : (n, components) array
        0 for constrained components, where the motions are set to zero; else 1.
    kinematics : Kinematics, optional
        Which motions there are: six in a solid, three in a plane, and of a body of revolution the
        translation along its axis and, with torsion, the rotation about it.
    """
    basis = []
    for motion in _motions(coordinates, kinematics):
        vector = PETSc.Vec().createMPI((free.size, None), bsize=free.shape[1], comm=comm)
        vector.array[:] = (motion * free).ravel()
        basis.append(vector)
    for i, vector in enumerate(basis):
        for other in basis[:i]:
            vector.axpy(-vector.dot(other), other)
        vector.normalize()
    return PETSc.NullSpace().create(vectors=basis, comm=comm)


def _motions(coordinates: np.ndarray, kinematics: Kinematics) -> list[np.ndarray]:
    """Return the rigid motions of points (n, 3), (n, components) each."""
    units = np.eye(3)
    if kinematics.revolved:
        along, around = (np.tile(units[i], (len(coordinates), 1)) for i in (1, 2))
        motions = [along, coordinates[:, :1] * around][: kinematics.components - 1]
        return [motion[:, : kinematics.components] for motion in motions]
    if kinematics.dim == 2:
        translations = [np.tile(axis, (len(coordinates), 1)) for axis in units[:2]]
        return [motion[:, :2] for motion in (*translations, np.cross(units[2], coordinates))]
    return [
        motion
        for axis in units
        for motion in (np.tile(axis, (len(coordinates), 1)), np.cross(axis, coordinates))
    ]
