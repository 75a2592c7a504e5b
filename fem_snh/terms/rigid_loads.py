"""Forces, moments and springs on rigid parts, and their prescribed motions. Not collective.

A drive is the force of a slider or the torque of a hinge. Forces and moments (6 parts,) are, for
each part, a force [N] and a moment about its point [N m], in global axes. Unknowns and twists are
those of `fem_snh.geometry.rigid_tree`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fem_snh.arrays import Array
from fem_snh.geometry.motions import path_rates
from fem_snh.geometry.rigid_tree import UNKNOWNS, Poses, RigidTree
from fem_snh.geometry.rotations import skew
from fem_snh.tables.amplitudes import Amplitudes
from fem_snh.terms.rigid import Rigid


class RigidLoads:
    """The loads, springs and drives that act on rigid parts, without the forces of the body.

    Parameters
    ----------
    parts : sequence of Rigid
        The parts.
    tree : RigidTree
        The parts' joints.
    amplitudes : Amplitudes
        The amplitudes of the loads.

    Attributes
    ----------
    drive : (6 parts,)
        The drives on the unknowns at the present load [N]; torques are divided by ``Link.length``.
    has_energy : bool
        Whether there are no moments, no forces that follow, and no drives.
    act : bool
        Whether there are loads or drives.
    """

    def __init__(self, parts: Sequence[Rigid], tree: RigidTree, amplitudes: Amplitudes) -> None:
        self._tree = tree
        self._factors = [amplitudes.force(part.load_table) for part in parts]
        self._full = np.array([[part.force, part.torque] for part in parts])
        self._follows = np.array([part.follower for part in parts])
        self._full_drive = np.concatenate(
            [_drive(part, link.length) for part, link in zip(parts, tree.links, strict=True)]
        )
        springs = [part.spring for part in parts]
        self._stiffness = np.array([s.stiffness if s else 0.0 for s in springs])
        self._rotational = np.array([s.rotation if s else 0.0 for s in springs])
        turning = self._full[:, 1].any() or self._full[self._follows, 0].any()
        self.has_energy = not (turning or self._full_drive.any())
        self.act = bool(self._full.any() or self._full_drive.any())
        self.set_load(0.0)

    def set_load(self, load: float) -> None:
        """Set the loads and drives at a load parameter."""
        factors = np.array([factor(load) for factor in self._factors])
        self._loads = factors[:, None, None] * self._full
        self.drive = np.repeat(factors, UNKNOWNS) * self._full_drive

    def energy(self, poses: Poses) -> float:
        """Return the energy [J] of springs and of forces of constant direction only."""
        moved = poses.c - self._tree.points
        energy = float(self._stiffness @ (moved**2).sum(axis=1)) / 2
        for i in np.flatnonzero(self._rotational):
            angle = self._tree.relative_rotation(poses, i)
            energy += self._rotational[i] / 2 * float(angle @ angle)
        return energy - float((self._loads[:, 0] * moved)[~self._follows].sum())

    def acting(self, poses: Poses) -> Array:
        """Return minus the forces and moments of loads and springs, (6 parts,)."""
        return self.loads(poses) + self.springs(poses)

    def loads(self, poses: Poses) -> Array:
        """Return minus the forces and moments of loads without drives, (6 parts,)."""
        loads, follow = self._loads.copy(), self._follows
        loads[follow] = loads[follow] @ np.swapaxes(poses.R[follow], 1, 2)
        return -loads.ravel()

    def springs(self, poses: Poses) -> Array:
        """Return minus the forces and moments of springs, (6 parts,)."""
        found = np.zeros_like(self._loads)
        found[:, 0] = self._stiffness[:, None] * (poses.c - self._tree.points)
        for i in np.flatnonzero(self._rotational):
            moment = self._rotational[i] * self._tree.relative_rotation(poses, i)
            found[i, 1] += moment
            if (parent := self._tree.links[i].parent) >= 0:
                found[parent, 1] -= moment
        return found.ravel()

    def spring_matrix(self, poses: Poses) -> Array:
        """Return the second derivative of the springs' energy by twists, (6 parts, 6 parts)."""
        found = np.diag(np.outer(self._stiffness, [1.0, 1.0, 1.0, 0.0, 0.0, 0.0]).ravel())
        for i in np.flatnonzero(self._rotational):
            found += self._rotational[i] * self._tree.spring_stiffness(poses, i)
        return found

    def turning(self, poses: Poses, wrenches: Array) -> Array:
        """Return the asymmetric part of the derivative of forces by twists, (6 parts, 6 parts).

        As parts turn, loads follow them, and moments change by half of their cross product with the
        rotation; `RigidTree.curvature` and `spring_matrix` lack both. ``wrenches`` (6 parts,) are
        the sums of dE/du, without loads and springs.
        """
        found = np.zeros((UNKNOWNS * len(self._loads),) * 2)
        loads = self.loads(poses).reshape(-1, 2, 3)
        for i, (acting, held) in enumerate(zip(loads, wrenches.reshape(-1, 2, 3), strict=True)):
            k = UNKNOWNS * i
            found[k + 3 : k + 6, k + 3 : k + 6] -= skew(held[1]) / 2
            if self._follows[i]:
                found[k : k + 3, k + 3 : k + 6] -= skew(acting[0])
                found[k + 3 : k + 6, k + 3 : k + 6] -= skew(acting[1])
        return found


def _drive(part: Rigid, length: float) -> Array:
    """Return a joint's drive on the part's unknowns at amplitude 1 [N], (6,)."""
    found = np.zeros(UNKNOWNS)
    if part.joint:
        found[0], found[3] = part.joint.force, part.joint.torque / length
    return found


class PrescribedMotions:
    """The displacements and rotations that ``translate`` and ``rotate`` prescribe.

    Parameters
    ----------
    parts : sequence of Rigid
        The parts.
    tree : RigidTree
        The parts' joints.
    amplitudes : Amplitudes
        The amplitudes of the motions, and the time of load 1.

    Attributes
    ----------
    move : bool
        Whether any motion is prescribed.
    """

    def __init__(self, parts: Sequence[Rigid], tree: RigidTree, amplitudes: Amplitudes) -> None:
        self._parts, self._tree, self._duration = list(parts), tree, amplitudes.duration
        self._motions = [amplitudes.motion(part.table) for part in parts]
        self._turns = [
            amplitudes.motion(part.rotate.table if part.rotate else None, motion)
            for part, motion in zip(parts, self._motions, strict=True)
        ]
        self.move = any(part.translate is not None or part.rotate is not None for part in parts)

    def at(self, load: float) -> tuple[Array, Array]:
        """Return points' displacements [m] and rotation vectors at a load, (parts, 3) each."""
        found = np.zeros((2, len(self._parts), 3))
        for i, part in enumerate(self._parts):
            amplitude, turn = self._motions[i](load), self._turns[i](load)
            found[0, i] = part.displacement(self._tree.points[i : i + 1], amplitude, turn)[0]
            if part.rotate:
                axis = np.array(part.rotate.axis) / np.linalg.norm(part.rotate.axis)
                found[1, i] = turn * part.rotate.angle * axis
        return found[0], found[1]

    def rates(self, load: float, step: float) -> tuple[Array, Array]:
        """Return the velocities [m/s] and accelerations [m/s^2] at a load, (parts, 2, 3) each.

        The middle axis is translation, and rotation times ``Link.length``. `path_rates` describes
        ``step``.
        """
        _, *rates = path_rates(lambda at: np.stack(self.at(at), axis=1), load, step)
        for power, rate in enumerate(rates, 1):
            rate /= (self._duration or 1.0) ** power
            rate[:, 1] *= np.array([link.length for link in self._tree.links])[:, None]
        return rates[0], rates[1]
