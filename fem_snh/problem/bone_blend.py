"""Move the flesh with its bones: the initial guess of a load step."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx

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
