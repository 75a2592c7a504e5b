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
from fem_snh.assembly.boundary_conditions import group_nodes
from fem_snh.assembly.kinematics import Kinematics
from fem_snh.mesh.mesh import Mesh

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
    groups : sequence of str, int or ReactionGroup
        The groups; of a name or a number alone the force.
    """

    def __init__(
        self,
        V: Any,
        mesh: Mesh,
        kinematics: Kinematics,
        groups: Sequence[str | int | ReactionGroup],
    ) -> None:
        self._comm, self._kinematics = mesh.domain.comm, kinematics
        owned = _dolfinx.num_nodes(V)[0]
        self._X: Array = V.tabulate_dof_coordinates()[:owned]
        self._nodes: dict[str, Array] = {}
        self._about: dict[str, Array] = {}
        for chosen in groups:
            if isinstance(chosen, str | int):
                key, about = chosen, None
            else:
                key, about = chosen.group, chosen.about
            nodes = group_nodes(V, mesh, key)
            self._nodes[str(key)] = nodes[nodes < owned]
            if about is not None:
                self._about[str(key)] = np.array(about)

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
        forces = self._kinematics.padded(gradient[:size])
        positions = self._X + self._kinematics.padded(x[:size])
        local = np.zeros((len(self._nodes), 2, 3))
        for row, (key, nodes) in zip(local, self._nodes.items(), strict=True):
            row[0] = forces[nodes].sum(axis=0)
            if key in self._about:
                row[1] = moment(self._kinematics, positions[nodes], forces[nodes], self._about[key])
        total = dict(zip(self._nodes, self._comm.allreduce(local).tolist(), strict=True))
        found = {"reactions": {key: force for key, (force, _) in total.items()}}
        moments = {key: total[key][1] for key in self._about}
        return found | ({"moments": moments} if moments else {})


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


def reaction(problem: Problem, mask: Array, about: Sequence[float] | Array = (0, 0, 0)) -> Array:
    """Return the force and the moment (2, 3) of the reaction at dofs. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, in its state ``x``.
    mask : (n, components) bool array
        The dofs of the owned nodes whose dE/du [N] count.
    about : (3,) sequence of float, optional
        The point of the moment [m].
    """
    gradient = problem.x.duplicate()
    problem.gradient(problem.x, gradient)
    kinematics = problem.kinematics
    forces = kinematics.padded(np.where(mask.ravel(), gradient.array_r[: mask.size], 0.0))
    positions = problem.coordinates + kinematics.padded(problem.x.array_r[: mask.size])
    local = [forces.sum(axis=0), moment(kinematics, positions, forces, np.array(about))]
    return np.asarray(problem.comm.allreduce(np.array(local)))
