"""What bones do to the body: forces and moments, and a first guess that moves it with them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.problem.problem import Problem

if TYPE_CHECKING:
    from fem_snh.problem.bone_nodes import BoneNodes

Array = npt.NDArray[Any]

#: Power of the distances. Above 3, the far bones together do not outweigh a near one; 2 to 4 cost
#: the same iterations in an arm of two bones.
_POWER = 4.0


class BoneBlend:
    r"""The weighted mean of the bones' motions at each node. Collective.

    From load s to load e, a node at x goes to

    .. math:: \sum_b w_b A_b(e) A_b(s)^{-1} x, \quad
              w_b = \frac{d_b^{-4}}{\sum_c d_c^{-4}},

    where d_b is the distance of the node's reference position from the closest node of bone b
    (linear blend skinning with the weights of Shepard 1968). It is exact if all bones have the same
    motion.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    bones : sequence of BoneNodes
        The bones.
    """

    def __init__(self, V: Any, bones: Sequence[BoneNodes]) -> None:
        from scipy.spatial import cKDTree  # slow to import

        self._bones, comm = list(bones), V.mesh.comm
        owned = _dolfinx.num_nodes(V)[0]
        self._X: Array = V.tabulate_dof_coordinates()[:owned]
        weights = np.empty((len(bones), owned))
        for row, bone in zip(weights, bones, strict=True):
            nodes = self._X[bone.nodes[bone.nodes < owned]]
            distance = cKDTree(np.concatenate(comm.allgather(nodes))).query(self._X)[0]
            row[:] = distance
        # Over the closest bone's distance, the largest weight is 1; nodes in bones have none.
        closest = np.maximum(weights.min(axis=0), np.finfo(float).tiny)
        weights = np.maximum(weights / closest, 1.0) ** -_POWER
        self._weights = weights / weights.sum(axis=0)

    def move(self, x: PETSc.Vec, start: float, end: float) -> None:
        """Move the displacement at the front of ``x`` from a load to another, in place."""
        X = self._X
        u = x.array[: X.size].reshape(-1, 3)
        position, moved = X + u, -X
        for bone, weight in zip(self._bones, self._weights, strict=True):
            before, after = bone.affine(start), bone.affine(end)
            rest = np.linalg.solve(before[:, :3], (position - before[:, 3]).T)
            moved += weight[:, None] * (after[:, :3] @ rest + after[:, 3:]).T
        u[:] = moved


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
