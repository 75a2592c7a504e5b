"""The near null space of an elastic stiffness matrix, which multigrid and deflation need."""

from __future__ import annotations

from collections.abc import Callable

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh.assembly.kinematics import SOLID, Kinematics


def rigid_motions(
    comm: MPI.Intracomm,
    coordinates: np.ndarray,
    project: Callable[[np.ndarray], None],
    kinematics: Kinematics = SOLID,
) -> PETSc.NullSpace:
    """Return the rigid motions of a displacement, orthonormal. Collective.

    Parameters
    ----------
    comm : MPI.Intracomm
        The communicator of the mesh.
    coordinates : (n, 3) array
        Reference coordinates of the nodes that this rank owns.
    project : callable
        Sets what is constrained of the nodes' displacements (components * n,) to zero, in place.
    kinematics : Kinematics, optional
        Which motions there are: six in a solid, three in a plane, and of a body of revolution the
        translation along its axis and, with torsion, the rotation about it.
    """
    basis = []
    for motion in _motions(coordinates, kinematics):
        vector = PETSc.Vec().createMPI((motion.size, None), bsize=motion.shape[1], comm=comm)
        vector.array[:] = motion.ravel()
        project(vector.array)
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
