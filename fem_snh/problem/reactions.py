r"""Reactions: the force on nodes and its moment about a point.

With the force r_i = dE/du_i that the constraints exert on node i, the deformed positions
x_i = X_i + u_i, and the point a,

.. math:: f = \sum_i r_i, \qquad m = \sum_i (x_i - a) \times r_i .

Both are exact for the discrete problem: together with all other forces they balance in rigid
translations and rotations. The nodal forces of a body of revolution are integrals over the whole
turn, in the basis (e_r, e_z, e_theta).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import (
    CountedForces,
    Dirichlet,
    counted_forces,
    group_forces,
    group_nodes,
)
from fem_snh.assembly.kinematics import Kinematics
from fem_snh.errors import bad_value, in_words
from fem_snh.geometry.rotations import rigid_displacements
from fem_snh.mesh.mesh import Mesh
from fem_snh.problem.conditions import condition_of

if TYPE_CHECKING:
    from fem_snh.problem.problem import Problem


class ReactionGroup(Protocol):
    """A physical group whose reaction is reported."""

    @property
    def group(self) -> str | int:
        """The group's name or number."""

    @property
    def about(self) -> Sequence[float] | None:
        """The (3,) point of the moment [m]; None for the force alone."""


class Reactions:
    """Reaction forces and moments of physical groups. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh
        The mesh.
    kinematics : Kinematics
        The kinematics of the displacement.
    dirichlet : Dirichlet
        The conditions: see `group_forces`.
    groups : sequence of str, int or ReactionGroup
        The groups; a name or a number asks for the force alone.

    Attributes
    ----------
    notes : list of str
        Notes on groups whose reaction includes or lacks forces of other groups' conditions.
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
        #: The owned nodes of each group whose forces count, and their `CountedForces.weights`.
        self._counted: dict[str, tuple[Array, Array]] = {}
        self._about: dict[str, Array] = {}
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
        """Return a note, or [], on a surface that other groups' conditions constrain in part.

        The surface is the group ``key``, without a condition of its own. Collective.
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
        """Return a note if later conditions override a group's conditions, or []. Collective."""
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
        x : (n,) array
            The unknowns [m] that this rank owns, displacements first.
        gradient : (n,) array
            dE/dx [N], of the same layout.

        Returns
        -------
        dict
            ``reactions``, the force (3,) [N] of each group by name, exerted on the body; and if
            groups have a point, ``moments``, the moment (3,) [N m] of each of these groups.
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
    """Return whether no condition or rigid part constrains a node of a group. Collective."""
    group = mesh.group(key)
    if problem.dirichlet.of_label(group.label):
        return False
    nodes = group_nodes(problem.V, mesh, key)
    constrained = problem.constrained_nodes
    local = int(constrained[nodes[nodes < len(constrained)]].sum())
    return not problem.comm.allreduce(local)


def weighted(weights: Array, vectors: Array) -> Array:
    """Return the counted parts (n, components) of nodal vectors (n, components).

    ``weights`` is (n, components, components), as from `counted_forces`, or a mask (n, components).
    """
    if weights.ndim == 2:
        return np.where(weights, vectors, 0.0)
    return np.asarray(np.einsum("nij,nj->ni", weights, vectors))


def moment(kinematics: Kinematics, x: Array, forces: Array, about: Array) -> Array:
    """Return this rank's moment (3,) [N m] of nodal forces about a point.

    Parameters
    ----------
    kinematics : Kinematics
        The kinematics. On a body of revolution a nodal force acts on the whole circle about y.
    x : (n, 3) array
        Deformed positions [m].
    forces : (n, 3) array
        Nodal forces [N].
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
    kinematics, x, about
        As for `moment`.
    axis : int
        The component, one of the kinematics' ``moment_axes``.
    """
    arms = x if kinematics.revolved else x - about
    found: Array = rigid_displacements(arms)[3 + axis, :, : kinematics.components]
    return found


def reaction(problem: Problem, weights: Array, about: Sequence[float] | Array = (0, 0, 0)) -> Array:
    """Return the reaction's force [N] and moment [N m], the rows of (2, 3). Collective.

    Parameters
    ----------
    problem : Problem
        The problem, in its state ``x``.
    weights : (owned nodes, components, components) or (owned nodes, components) array
        Which parts of the nodal forces dE/du [N] count: see `weighted`.
    about : (3,) sequence of float, optional
        The point of the moment [m].
    """
    kinematics, nodal = problem.kinematics, problem.nodal(problem.gradient_at(problem.x))
    forces = kinematics.padded(weighted(weights, nodal))
    positions = problem.coordinates + kinematics.padded(problem.nodal(problem.x))
    local = [forces.sum(axis=0), moment(kinematics, positions, forces, np.array(about))]
    return np.asarray(problem.comm.allreduce(np.array(local)))


def counted_weights(problem: Problem, condition: Any) -> Array:
    """Return the weights of nodal forces that a condition exerts. Collective.

    They are the `CountedForces.weights`, (owned nodes, components, components).

    Raises
    ------
    BadInput
        On every rank, for an object that is not one of the problem's ``bcs``.
    """
    size = len(problem.coordinates), problem.kinematics.components
    found = condition_of(problem.dirichlet, condition, "condition")
    return counted_forces(problem.dirichlet, [found], *size).weights


def check_point(key: str, value: Any) -> list[float]:
    """Return three finite numbers as floats; raise BadInput for anything else."""
    try:
        numbers = np.asarray(value, dtype=float)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.shape != (3,) or not np.isfinite(numbers).all():
        raise bad_value(key, value, "a point [x, y, z]")
    return [float(x) for x in numbers]
