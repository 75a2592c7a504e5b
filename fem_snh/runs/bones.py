"""The bones of a scene: the nodes that follow them, and what run.json has of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

import numpy as np

from fem_snh.errors import on_every
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.bone_nodes import BoneNodes, place_bones
from fem_snh.problem.problem import Problem
from fem_snh.runs.obstacle_records import surface_name
from fem_snh.scenes import Scene
from fem_snh.scenes.bone_files import read_bones


def scene_bones(scene: Scene, V: Any, mesh: Mesh) -> list[BoneNodes]:
    """Return the bones of a scene with their nodes. Collective.

    Raises
    ------
    BadInput
        On every rank, for a file that cannot be read or is not valid, for a group that is unknown
        or no volume, and for a bone without a node.
    """
    comm = mesh.domain.comm
    bones = on_every(comm, read_bones, scene)
    return place_bones(V, mesh, bones)


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
        from fem_snh.problem.bone_blend import BoneBlend

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


def describe_bones(scene: Scene, problem: Problem) -> dict[str, dict[str, Any]]:
    """Return the bones of a scene by name, as run.json has them before the first step.

    Each has its ``shape``, a table of one key as in the scene, or ``group``; the number of its
    ``nodes``; and ``pose``, the three rows [A | c] of its map at load 0.
    """
    found = {}
    placed: list[BoneNodes] = getattr(problem.dirichlet, "bones", [])
    for choice, bone in zip(scene.bone, placed, strict=True):
        kind: dict[str, Any] = {"group": choice.group}
        if choice.shape is not None:
            kind = {"shape": choice.shape.record()}
        elif choice.surface is not None:
            kind = {"shape": {"surface": surface_name(scene, choice)}}
        pose = bone.affine(0.0).tolist()
        found[choice.name] = {**kind, "nodes": bone.count, "length": bone.length, "pose": pose}
    return found
