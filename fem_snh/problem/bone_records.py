"""Forces and moments that bones exert on the body, as run.json has them."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np

from fem_snh.problem.bone_blend import BoneBlend
from fem_snh.problem.problem import Problem

if TYPE_CHECKING:
    from fem_snh.problem.bone_nodes import BoneNodes


class BoneRecords:
    """Forces and moments that the bones exert on the body.

    Parameters
    ----------
    problem : Problem
        A problem whose `DirichletConditions` have bones.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._bones: list[BoneNodes] = list(getattr(problem.dirichlet, "bones", ()))

    def blend(self) -> Callable[[PETSc.Vec, float, float], None]:
        """Return the function that moves the flesh with the bones. Collective."""
        return BoneBlend(self._problem.V, self._bones).move

    def row(self) -> dict[str, dict[str, Any]]:
        """Return what run.json has of each bone at the present state, by name. Collective.

        Returns
        -------
        dict
            ``force`` [N], the sum of dE/du over the bone's nodes; ``moment`` [N m] of these forces
            about ``origin``, the present position [length] of the bone's origin; ``nodes``, their
            number; ``pose``, the three rows [A | c].
        """
        problem = self._problem
        X, r = problem.coordinates, problem.x.duplicate()
        problem.gradient(problem.x, r)
        f = r.array_r[: 3 * len(X)].reshape(-1, 3)
        x = X + problem.x.array_r[: 3 * len(X)].reshape(-1, 3)
        poses = [bone.affine(problem.load) for bone in self._bones]
        origins = [p[:, :3] @ b.origin + p[:, 3] for p, b in zip(poses, self._bones, strict=True)]
        local = np.zeros((len(self._bones), 2, 3))
        for sums, bone, origin in zip(local, self._bones, origins, strict=True):
            nodes = bone.nodes[bone.nodes < len(X)]
            sums[0] = f[nodes].sum(axis=0)
            sums[1] = np.cross(x[nodes] - origin, f[nodes]).sum(axis=0)
        total = problem.comm.allreduce(local)
        return {
            bone.bone.name: {
                "force": total[i, 0].tolist(),
                "moment": total[i, 1].tolist(),
                "origin": origins[i].tolist(),
                "nodes": bone.count,
                "pose": poses[i].tolist(),
            }
            for i, bone in enumerate(self._bones)
        }
