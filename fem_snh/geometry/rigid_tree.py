r"""The motions of rigid parts that joints connect to the world or to each other.

The points of a part are at :math:`x = c + R (X - p)`, with p the part's reference point. The six
unknowns of a part without a joint are a translation v [m] from the present pose, and a rotation
:math:`\omega` [rad] about the global axes times a length:

.. math:: c(s) = c + s v, \qquad R(s) = \exp(s [\omega]_\times) R .

A joint leaves some unknowns. A ball joint at p moves c with the parent. A hinge leaves the rotation
about an axis (unknown 3), and a slider the translation along an axis (unknown 0). The axis turns
with the parent, and so does the motion relative to the parent. Derivatives along these paths are
exact at every s. A twist (v, omega) is the rate of c and the angular velocity, in global axes.
Arrays (6 parts,) have six entries for each part.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from fem_snh.arrays import Array
from fem_snh.geometry.rotations import (
    exponential,
    inverse_left_jacobian,
    nearest_rotation,
    skew,
    turn_about,
)

#: Unknowns of a part.
UNKNOWNS = 6
#: The unknowns that each kind of joint leaves: 0 to 2 are v, 3 to 5 omega times a length.
JOINTS = {
    "": (0, 1, 2, 3, 4, 5),
    "ball": (3, 4, 5),
    "hinge": (3,),
    "slider": (0,),
}


class Poses(NamedTuple):
    """Positions c (parts, 3) of the parts' points and rotations R (parts, 3, 3)."""

    c: Array
    R: Array


@dataclass(frozen=True)
class Link:
    """A part with its joint, or with its free motions.

    Attributes
    ----------
    point : (3,) array
        The reference coordinates [m] of the part's point p.
    length : float
        The length [m] by which rotations are scaled.
    joint : str
        One of `JOINTS`; empty for a part without a joint.
    axis : (3,) array
        The unit vector of a hinge or a slider in the reference configuration; otherwise zero.
    parent : int
        The number of the part that the joint connects to; -1 for the world.
    free : (4,) tuple of bool
        Of a part without a joint: whether the translations along x, y, z and the rotation are free.
    motions : (6,) tuple of bool
        Which translations along x, y, z and rotations about them the kinematics has.
    """

    point: Array
    length: float
    joint: str = ""
    axis: Array = field(default_factory=lambda: np.zeros(3))
    parent: int = -1
    free: tuple[bool, bool, bool, bool] = (True, True, True, True)
    motions: tuple[bool, ...] = (True,) * UNKNOWNS

    @property
    def free_unknowns(self) -> Array:
        """Which unknowns are free, (6,) bool."""
        chosen = np.isin(np.arange(UNKNOWNS), JOINTS[self.joint])
        if self.joint in ("", "ball"):  # the others have unknowns along or about their axis
            chosen &= np.array(self.motions)
        return chosen if self.joint else chosen & np.repeat(self.free, (1, 1, 1, 3))

    def nearest_rotation(self, A: Array) -> Array:
        """Return the rotation among ``motions`` that is nearest to a matrix (3, 3)."""
        axes = np.eye(3)[list(self.motions[3:])]
        if len(axes) == 3:
            return nearest_rotation(A)
        return exponential(turn_about(axes[0], A) * axes[0]) if len(axes) else np.eye(3)


class RigidTree:
    """Rigid parts and their joints, which form no loops.

    Parameters
    ----------
    links : sequence of Link
        The parts.

    Attributes
    ----------
    points : (parts, 3) array
        The reference coordinates [m] of the parts' points.
    free : (6 parts,) bool array
        Which unknowns are free.
    order : list of int
        The numbers of the parts, each after its parent.
    """

    def __init__(self, links: Sequence[Link]) -> None:
        self.links = list(links)
        self.points = np.array([link.point for link in links])
        self.free = np.concatenate([link.free_unknowns for link in links])
        self.order: list[int] = []  # parents before their children
        while len(self.order) < len(links):
            self.order += [
                i
                for i, link in enumerate(links)
                if i not in self.order and (link.parent < 0 or link.parent in self.order)
            ]

    def ancestors(self, part: int) -> list[int]:
        """Return the numbers of a part, its parent, the parent's parent, and so on."""
        found = [part]
        while (part := self.links[part].parent) >= 0:
            found.append(part)
        return found

    def _parent(self, poses: Poses, link: Link) -> tuple[Array, Array, Array]:
        """Return p, c and R of a link's parent; for the world 0, 0 and I."""
        if link.parent < 0:
            return np.zeros(3), np.zeros(3), np.eye(3)
        return self.points[link.parent], poses.c[link.parent], poses.R[link.parent]

    @staticmethod
    def _own_twist(link: Link, turned: Array) -> Array:
        """Return the derivative of a part's twist by its own unknowns, (6, 6).

        The twist is relative to the parent. ``turned`` (3, 3) is the parent's rotation, with which
        the axis turns.
        """
        twist = np.diag([1.0] * 3 + [1 / link.length] * 3)
        twist[:, ~np.isin(np.arange(UNKNOWNS), JOINTS[link.joint])] = 0.0
        if link.joint == "hinge":
            twist[3:, 3] = turned @ link.axis / link.length
        elif link.joint == "slider":
            twist[:3, 0] = turned @ link.axis
        return twist

    def project(self, poses: Poses, translations: Array, rotations: Array) -> Poses:
        """Return poses near given ones that satisfy joints and prescribed motions.

        Parameters
        ----------
        poses : Poses
            The given poses.
        translations : (parts, 3) array
            Prescribed displacements [m] of the points; free components are not read.
        rotations : (parts, 3, 3) array
            Prescribed rotations; those of parts with a free rotation are not read.
        """
        c, R = poses.c.copy(), poses.R.copy()
        for i in self.order:
            link = self.links[i]
            point, carrier, turned = self._parent(Poses(c, R), link)
            if not link.joint:
                fixed = ~(np.array(link.free[:3]) & link.motions[:3])
                c[i, fixed] = (self.points[i] + translations[i])[fixed]
                R[i] = R[i] if link.free[3] else rotations[i]
                continue
            joint, slide = carrier + turned @ (link.point - point), 0.0
            if link.joint == "slider":
                axis = turned @ link.axis
                slide = float(axis @ (c[i] - joint))
                joint, R[i] = joint + slide * axis, turned
            elif link.joint == "hinge":
                angle = turn_about(link.axis, turned.T @ R[i])
                R[i] = turned @ exponential(angle * link.axis)
            c[i] = joint
        return Poses(c, R)

    def move(self, poses: Poses, q: Array) -> Poses:
        """Return the poses at s = 1 of the paths with unknowns q (6 parts,) [m] from ``poses``."""
        c, R, q = poses.c.copy(), poses.R.copy(), q.reshape(-1, UNKNOWNS)
        for i in self.order:
            link = self.links[i]
            _, before, turned = self._parent(poses, link)
            _, after, turned_after = self._parent(Poses(c, R), link)
            turn = turned_after @ turned.T
            own = self._own_twist(link, turned) @ q[i]
            c[i] = after + turn @ (poses.c[i] - before + own[:3])
            carried = turn if link.joint in ("hinge", "slider") else np.eye(3)
            R[i] = carried @ exponential(own[3:]) @ poses.R[i]
        return Poses(c, R)

    def jacobian(self, poses: Poses) -> Array:
        """Return the derivative of the parts' twists by all unknowns, (6 parts, 6 parts).

        The columns of prescribed unknowns are not zero.
        """
        G = np.zeros((UNKNOWNS * len(self.links),) * 2)
        for i in self.order:
            link, k = self.links[i], UNKNOWNS * i
            _, carrier, turned = self._parent(poses, link)
            G[k : k + 6, k : k + 6] = self._own_twist(link, turned)
            if link.joint and link.parent >= 0:
                p = UNKNOWNS * link.parent
                G[k : k + 3] += G[p : p + 3] - skew(poses.c[i] - carrier) @ G[p + 3 : p + 6]
                if link.joint != "ball":
                    G[k + 3 : k + 6] += G[p + 3 : p + 6]
        return G

    def curvature(self, poses: Poses, G: Array, wrenches: Array, moments: Array) -> Array:
        """Return the second derivative, by unknowns, of the work of constant forces f on paths.

        Parameters
        ----------
        poses : Poses
            The poses at s = 0.
        G : (6 parts, 6 parts) array
            Their `jacobian`.
        wrenches : (6 parts,) array
            The sums of the forces f on each part, and of their moments (x - c) x f.
        moments : (parts, 3, 3) array
            The sums of f (x - c)^T.
        """
        size = len(G)
        twists, unknowns = np.zeros((size, size)), np.zeros((size, size))
        sums = wrenches.reshape(-1, 2, 3).copy()  # with those of the parts that a part carries

        def add_turn(part: int, S: Array) -> None:
            w = slice(UNKNOWNS * part + 3, UNKNOWNS * part + 6)
            twists[w, w] += (S + S.T) / 2 - np.trace(S) * np.eye(3)

        for i in reversed(self.order):
            link, (force, moment) = self.links[i], sums[i]
            add_turn(i, moments[i])
            if not link.joint or link.parent < 0:
                continue
            a = link.parent
            _, carrier, turned = self._parent(poses, link)
            arm, w = poses.c[i] - carrier, slice(UNKNOWNS * a + 3, UNKNOWNS * a + 6)
            add_turn(a, np.outer(force, arm))
            sums[a, 0] += force
            sums[a, 1] += np.cross(arm, force)
            if link.joint != "ball":
                sums[a, 1] += moment
                axis, k = turned @ link.axis, UNKNOWNS * i
                if link.joint == "hinge":
                    mixed, k = np.cross(axis, moment) / (2 * link.length), k + 3
                else:
                    mixed = np.cross(axis, force)
                row = mixed @ G[w]
                unknowns[k] += row
                unknowns[:, k] += row
        return np.asarray(G.T @ twists @ G + unknowns)

    def accelerations(self, poses: Poses, G: Array, rates: Array) -> Array:
        """Return the accelerations of the parts at constant rates of the unknowns.

        Parameters
        ----------
        poses : Poses
            The poses.
        G : (6 parts, 6 parts) array
            Their `jacobian`.
        rates : (6 parts,) array
            The rates of the unknowns [m/s].

        Returns
        -------
        (parts, 2, 3) array
            The acceleration of each part's point [m/s^2], and its angular acceleration [rad/s^2].
        """
        found, q = np.zeros((len(self.links), 2, 3)), rates.reshape(-1, UNKNOWNS)
        twists = (G @ rates).reshape(-1, 2, 3)
        for i in self.order:
            link = self.links[i]
            if not link.joint or link.parent < 0:
                continue
            a = link.parent
            _, carrier, turned = self._parent(poses, link)
            arm, omega, axis = poses.c[i] - carrier, twists[a, 1], turned @ link.axis
            found[i, 0] = found[a, 0] + np.cross(found[a, 1], arm)
            found[i, 0] += np.cross(omega, np.cross(omega, arm))
            if link.joint == "slider":
                found[i, 0] += 2 * q[i, 0] * np.cross(omega, axis)
            if link.joint != "ball":
                found[i, 1] = found[a, 1]
            if link.joint == "hinge":
                found[i, 1] += q[i, 3] / link.length * np.cross(omega, axis)
        return found

    def relative_rotation(self, poses: Poses, part: int) -> Array:
        """Return the rotation vector (3,) [rad] of R R_p^T, R_p the rotation of a part's parent.

        R_p = I without a parent. Axes are the fixed x, y, z; the norm is at most pi.
        """
        parent = self.links[part].parent
        R = poses.R[part]
        return rotation_vector(R @ poses.R[parent].T if parent >= 0 else R)

    def spring_stiffness(self, poses: Poses, part: int) -> Array:
        """Return the second derivative of ``theta @ theta / 2`` by twists, (6 parts, 6 parts).

        theta is the `relative_rotation`.
        """
        theta, size = self.relative_rotation(poses, part), UNKNOWNS * len(self.links)
        J, found = inverse_left_jacobian(theta), np.zeros((size, size))
        w, parent = slice(UNKNOWNS * part + 3, UNKNOWNS * part + 6), self.links[part].parent
        found[w, w] = (J + J.T) / 2
        if parent >= 0:
            a = slice(UNKNOWNS * parent + 3, UNKNOWNS * parent + 6)
            found[a, a] = found[w, w]
            found[a, w], found[w, a] = -J, -J.T
        return found


def rotation_vector(R: Array) -> Array:
    """Return the rotation vector (3,) of a rotation matrix (3, 3); its norm is at most pi."""
    return np.asarray(Rotation.from_matrix(R).as_rotvec())


def fit_poses(links: Sequence[Link], means: Array, places: Array, products: Array) -> Poses:
    """Return the poses that fit the present positions x of nodes best, in least squares.

    Parameters
    ----------
    links : sequence of Link
        The parts; their joints are ignored.
    means : (parts, 3) array
        Means of the nodes' reference coordinates X [m]; on a body of revolution, over circles.
    places : (parts, 3) array
        Means of the positions x, likewise.
    products : (parts, 3, 3) array
        The sums of x (X - mean X)^T.
    """
    R = np.array([link.nearest_rotation(A) for link, A in zip(links, products, strict=True)])
    arms = np.array([link.point for link in links]) - means
    return Poses(places + np.einsum("nij,nj->ni", R, arms), R)
