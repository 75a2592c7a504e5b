"""Dirichlet conditions: which displacement components are constrained, and their values."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.fem.mesh import Mesh

Array = npt.NDArray[Any]

AXES = ("x", "y", "z")


class Constraint(Protocol):
    """Components of the displacement on a physical group that are zero."""

    @property
    def group(self) -> str | int:
        """Name or number of the physical group."""

    @property
    def components(self) -> Sequence[str]:
        """The constrained components, among "x", "y" and "z"."""


class Motion(Constraint, Protocol):
    """Components of the displacement on a physical group that follow the load."""

    def displacement(self, X: Array, load: float) -> Array:
        """Return the (n, 3) displacement [m] of reference points X (n, 3) at a load of 0 to 1."""


class NodalMotion(Protocol):
    """The displacement of some nodes, in all components, as a function of the load."""

    @property
    def nodes(self) -> Array:
        """The local nodes, ghosts included."""

    @property
    def moves(self) -> bool:
        """Whether the displacement is not zero."""

    def displacement(self, X: Array, load: float) -> Array:
        """Return the (n, 3) displacement [m] of reference points X (n, 3) at a load of 0 to 1."""


class Dirichlet(Protocol):
    """The constrained dofs of a displacement space and their values.

    Attributes
    ----------
    constrained : (local nodes, 3) bool
        Which components of which nodes, ghosts included, are constrained.
    dofs : (n,) int
        The constrained dofs this rank owns, as indices into a vector's local array.
    depends_on_load : bool
        Whether any value depends on the load.
    """

    constrained: Array
    dofs: Array
    depends_on_load: bool

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set the constrained entries of ``x`` to their values at this load."""


class DirichletConditions:
    """Dirichlet conditions on physical groups, with the attributes of `Dirichlet`. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space, 3 components.
    mesh : Mesh
        The mesh whose physical groups the conditions name.
    hold : sequence of Constraint
        Zero displacement.
    move : sequence of Motion
        Displacement that follows the load. Where conditions overlap, a later one overrides an
        earlier one, and any of ``move`` overrides ``hold``.
    bones : sequence of NodalMotion, optional
        Displacements of nodes, different ones, which override all others.

    Raises
    ------
    BadInput
        On every rank, for an unknown physical group.
    """

    def __init__(
        self,
        V: Any,
        mesh: Mesh,
        hold: Sequence[Constraint],
        move: Sequence[Motion],
        bones: Sequence[NodalMotion] = (),
    ) -> None:
        owned, ghosts = _dolfinx.num_nodes(V)
        self.constrained: Array = np.zeros((owned + ghosts, 3), dtype=bool)
        self.bones = list(bones)
        self._moved: list[tuple[Array, list[int], Motion | NodalMotion, Array]] = []
        for condition in hold:
            self._constrain(V, mesh, condition)
        coordinates = V.tabulate_dof_coordinates()
        for motion in move:
            nodes, axes = self._constrain(V, mesh, motion)
            nodes = nodes[nodes < owned]
            self._moved.append((nodes, axes, motion, coordinates[nodes]))
        for bone in bones:
            self.constrained[bone.nodes] = True
            nodes = bone.nodes[bone.nodes < owned]
            self._moved.append((nodes, [0, 1, 2], bone, coordinates[nodes]))
        self.dofs: Array = np.flatnonzero(self.constrained[:owned])
        self.depends_on_load = bool(move) or any(bone.moves for bone in bones)

    def _constrain(self, V: Any, mesh: Mesh, condition: Constraint) -> tuple[Array, list[int]]:
        """Mark a condition's components as constrained; return its local nodes and components."""
        nodes = group_nodes(V, mesh, condition.group)
        axes = [AXES.index(c) for c in condition.components]
        self.constrained[nodes[:, None], axes] = True
        return nodes, axes

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set the constrained entries of ``x`` to their values at this load."""
        values = x.array
        values[self.dofs] = 0.0
        for nodes, axes, motion, points in self._moved:
            displacement = motion.displacement(points, load)
            values[3 * nodes[:, None] + axes] = displacement[:, axes]


def group_nodes(V: Any, mesh: Mesh, key: str | int) -> Array:
    """Return the local nodes of V, ghosts included, on a physical group. Collective."""
    group = mesh.group(key)
    return _dolfinx.locate_dofs(V, group.dim, group.entities)
