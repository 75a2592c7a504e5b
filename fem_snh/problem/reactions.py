r"""Reactions: the force on nodes and its moment about a point.

With the forces r_i = dE/du at the nodes, where the constraints act on the body, and the deformed
positions x_i = X_i + u_i,

.. math:: f = \sum_i r_i, \qquad m = \sum_i (x_i - a) \times r_i .

Both are exact for the discrete problem: they are the forces that balance all others in rigid
translations and rotations. The nodal forces of a body of revolution are those of the whole turn, of
which only the moment about the axis and the axial force remain.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import (
    CountedForces,
    Dirichlet,
    counted_forces,
    group_forces,
    group_nodes,
)
from fem_snh.assembly.kinematics import Kinematics
from fem_snh.errors import bad_value, in_words
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.conditions import condition_of

if TYPE_CHECKING:
    from fem_snh.problem.problem import Problem

Array = npt.NDArray[Any]


class ReactionGroup(Protocol):
    """A physical group whose reaction is reported."""

    @property
    def group(self) -> str | int:
        """The group's name or number."""

    @property
    def about(self) -> Sequence[float] | None:
        """The (3,) point of the moment [m]; None for the force alone."""


class Reactions:
    """Forces and moments of physical groups. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh
        The mesh.
    kinematics : Kinematics
        The kinematics of the displacement.
    dirichlet : Dirichlet
        The conditions, of which a group has the forces of its own: see `group_forces`.
    groups : sequence of str, int or ReactionGroup
        The groups; of a name or a number alone the force.
    """

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        mesh: Mesh,
        kinematics: Kinematics,
        dirichlet: Dirichlet,
        groups: Sequence[str | int | ReactionGroup],
    ) -> None:
        self._comm, self._kinematics = mesh.domain.comm, kinematics
        owned = _dolfinx.num_nodes(V)[0]
        self._X: Array = V.tabulate_dof_coordinates()[:owned]
        #: The nodes of each group whose forces count, and their weights.
        self._counted: dict[str, tuple[Array, Array]] = {}
        self._about: dict[str, Array] = {}
        #: Lines on surfaces that have the forces of other conditions alone.
        self.notes: list[str] = []
        for chosen in groups:
            if isinstance(chosen, str | int):
                key, about = chosen, None
            else:
                key, about = chosen.group, chosen.about
            counted = group_forces(V, mesh, key, dirichlet)
            nodes = np.flatnonzero(counted.weights.any(axis=(1, 2)))
            self._counted[str(key)] = nodes, counted.weights[nodes]
            self.notes += self._shared(V, mesh, key, dirichlet)
            self.notes += self._overridden(key, counted)
            if about is not None:
                self._about[str(key)] = np.array(about)

    def _shared(
        self, V: _dolfinx.FunctionSpace, mesh: Mesh, key: str | int, dirichlet: Dirichlet
    ) -> list[str]:
        """Return a line if other conditions constrain a part of a surface without any. Collective.

        One that they constrain as a whole has the force of them.
        """
        group = mesh.group(key)
        if group.dim != mesh.dim - 1 or dirichlet.of_label(group.label):
            return []
        nodes = group_nodes(V, mesh, key)
        nodes = nodes[nodes < len(self._X)]
        local = [int(dirichlet.constrained_nodes[nodes].sum()), len(nodes)]
        constrained, every = self._comm.allreduce(np.array(local)).tolist()
        if constrained in (0, every):
            return []
        return [
            f"reactions of {key!r}: no condition is of this group, and others constrain "
            f"{constrained} of its {every} nodes: the force is the part of theirs at these nodes, "
            "which depends on the mesh"
        ]

    def _overridden(self, key: str | int, counted: CountedForces) -> list[str]:
        """Return a line if a group's conditions share nodes that others set. Collective."""
        gathered = self._comm.allgather((counted.shared, counted.others))
        shared = sum(count for count, _ in gathered)
        if not shared:
            return []
        names = sorted(set[str]().union(*(names for _, names in gathered)))
        others = in_words(map(repr, names))
        return [
            f"reactions of {key!r}: its conditions and those of {others} constrain the same "
            f"components at {shared} nodes, whose force counts for the last one, so that the sum "
            "of all reactions balances the loads"
        ]

    def sums(self, x: Array, gradient: Array) -> dict[str, dict[str, list[float]]]:
        """Return forces and moments. Collective.

        Parameters
        ----------
        x, gradient : (n,) array
            This rank's unknowns [m] and dE/dx [N]; the displacement's entries are the first.

        Returns
        -------
        dict
            ``reactions``, the force [N] on each group; ``moments``, the moment [N m] of those with
            a point, if there are any.
        """
        size = self._kinematics.components * len(self._X)
        nodal = gradient[:size].reshape(-1, self._kinematics.components)
        positions = self._X + self._kinematics.padded(x[:size])
        local = np.zeros((len(self._counted), 2, 3))
        for row, (key, (nodes, weights)) in zip(local, self._counted.items(), strict=True):
            counted = self._kinematics.padded(weighted(weights, nodal[nodes]))
            row[0] = counted.sum(axis=0)
            if key in self._about:
                row[1] = moment(self._kinematics, positions[nodes], counted, self._about[key])
        total = dict(zip(self._counted, self._comm.allreduce(local).tolist(), strict=True))
        found = {"reactions": {key: force for key, (force, _) in total.items()}}
        moments = {key: total[key][1] for key in self._about}
        return found | ({"moments": moments} if moments else {})


def is_free(problem: Problem, mesh: Mesh, key: str | int) -> bool:
    """Return whether nothing constrains a group, whose force is the residual. Collective."""
    group = mesh.group(key)
    if problem.dirichlet.of_label(group.label):
        return False
    nodes = group_nodes(problem.V, mesh, key)
    constrained = problem.constrained_nodes
    local = int(constrained[nodes[nodes < len(constrained)]].sum())
    return not problem.comm.allreduce(local)


def weighted(weights: Array, vectors: Array) -> Array:
    """Return the parts of nodal vectors (n, components) that count.

    ``weights`` are those of `counted_forces`, or a mask (n, components) of components.
    """
    if weights.ndim == 2:
        return np.where(weights, vectors, 0.0)
    return np.asarray(np.einsum("nij,nj->ni", weights, vectors))


def moment(kinematics: Kinematics, x: Array, forces: Array, about: Array) -> Array:
    """Return the moment (3,) of forces about a point.

    Parameters
    ----------
    kinematics : Kinematics
        A body of revolution turns the forces about its axis, y; its moment is that of the turn.
    x, forces : (n, 3) array
        Deformed positions [m] and forces [N].
    about : (3,) array
        The point [m].
    """
    if not kinematics.revolved:
        return np.asarray(np.cross(x - about, forces).sum(axis=0))
    torque = (x[:, 2] * forces[:, 0] - x[:, 0] * forces[:, 2]).sum()
    axial = forces[:, 1].sum()
    return np.array([about[2] * axial, torque, -about[0] * axial])


def virtual_rotation(kinematics: Kinematics, x: Array, axis: int, about: Array) -> Array:
    """Return the virtual displacement (n, components) whose work is a component of `moment`.

    Parameters
    ----------
    kinematics, x, about : Kinematics, (n, 3) array, (3,) array
        As for `moment`.
    axis : int
        The component, one of the kinematics' ``moment_axes``.
    """
    arms = x if kinematics.revolved else x - about
    rotation: Array = np.cross(np.eye(3)[axis], arms)
    return rotation[:, : kinematics.components]


def reaction(problem: Problem, weights: Array, about: Sequence[float] | Array = (0, 0, 0)) -> Array:
    """Return the force and the moment (2, 3) of the reaction at dofs. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, in its state ``x``.
    weights : array
        Which parts of dE/du [N] at the owned nodes count: see `weighted`.
    about : (3,) sequence of float, optional
        The point of the moment [m].
    """
    gradient = problem.x.duplicate()
    problem.gradient(problem.x, gradient)
    kinematics = problem.kinematics
    size = len(weights) * kinematics.components
    nodal = gradient.array_r[:size].reshape(-1, kinematics.components)
    forces = kinematics.padded(weighted(weights, nodal))
    positions = problem.coordinates + kinematics.padded(problem.x.array_r[:size])
    local = [forces.sum(axis=0), moment(kinematics, positions, forces, np.array(about))]
    return np.asarray(problem.comm.allreduce(np.array(local)))


def counted_weights(problem: Problem, condition: Any) -> Array:
    """Return the weights of the owned nodes' forces that a condition exerts. Collective.

    Raises
    ------
    BadInput
        On every rank, for what is not one of the problem's ``bcs``.
    """
    size = len(problem.coordinates), problem.kinematics.components
    found = condition_of(problem.dirichlet, condition, "condition")
    return counted_forces(problem.dirichlet, [found], *size).weights


def three_numbers(key: str, value: Any) -> list[float]:
    """Return three finite numbers as floats; raise BadInput for anything else."""
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise bad_value(key, value, "a point [x, y, z]")
    return [float(x) for x in numbers]
