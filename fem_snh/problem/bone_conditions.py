"""Bones in a dolfinx program: Dirichlet conditions whose values follow the bones' motions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fem_snh import _dolfinx
from fem_snh.geometry.bones import Bone
from fem_snh.problem.bone_nodes import place_bones


class BoneConditions:
    """The nodes in bones, constrained in all components. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space, Lagrange with 3 components.
    bones : sequence of Bone
        The bones, with different names and with shapes: a dolfinx mesh has no groups.

    Attributes
    ----------
    bones : list of BoneNodes
        The bones with their nodes: see `fem_snh.problem.bone_nodes.place_bones`.
    displacement : dolfinx Function
        Their displacement [m] at the load that was set last; zero at other nodes.
    bcs : list of dolfinx DirichletBC
        The conditions.

    Raises
    ------
    BadInput
        On every rank, for a bone without a node or with a singular map.

    Examples
    --------
    >>> lower = Bone("lower", Capsule((0, 0, 0), (0, 0, 0.3), 0.02), motion=flexion)
    >>> conditions = BoneConditions(V, [lower])
    >>> problem = fem_snh.NonlinearProblem(u, {m: ufl.dx}, bcs=conditions.bcs)
    >>> for load in (0.25, 0.5, 0.75, 1.0):
    ...     conditions.set_load(load)
    ...     problem.solve()
    """

    def __init__(self, V: Any, bones: Sequence[Bone]) -> None:
        self.bones = place_bones(V, None, bones)
        self.displacement = _dolfinx.function(V, "displacement of bones")
        nodes = np.unique(np.concatenate([bone.nodes for bone in self.bones]))
        self.bcs = [_dolfinx.prescribed(self.displacement, nodes)]
        self._X = V.tabulate_dof_coordinates()
        self.set_load(0.0)

    def set_load(self, load: float) -> None:
        """Set the conditions' values to the bones' displacement at a load from 0 to 1."""
        values = self.displacement.x.array.reshape(-1, 3)
        for bone in self.bones:
            values[bone.nodes] = bone.displacement(self._X[bone.nodes], load)
