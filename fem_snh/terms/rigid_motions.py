"""The prescribed motions of rigid parts, and their rates in time. Not collective."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.geometry.rigid_tree import RigidTree
from fem_snh.tables.amplitudes import Amplitudes
from fem_snh.tables.motions import rigid_displacement
from fem_snh.terms.rigid import Rigid

Array = npt.NDArray[Any]

#: Spacing, in load, of the differences that are prescribed velocities and accelerations: their
#: rounding errors are 1e-12 and 1e-8.
_SPACING = 1e-4
#: One-sided differences of second order, the first and the second one: weights of four values.
_FIRST, _SECOND = (-1.5, 2.0, -0.5, 0.0), (2.0, -5.0, 4.0, -1.0)


class PrescribedMotions:
    """The displacements and rotations that ``translate`` and ``rotate`` prescribe.

    Parameters
    ----------
    parts : sequence of Rigid
        The parts.
    tree : RigidTree
        How they may move.
    amplitudes : Amplitudes
        Those of the motions, and the time of load 1.

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
        """Return displacements of points [m] and rotation vectors at a load, (parts, 3) each."""
        found = np.zeros((2, len(self._parts), 3))
        for i, part in enumerate(self._parts):
            amplitude, turn = self._motions[i](load), self._turns[i](load)
            motion = part.translate, part.rotate, amplitude, turn
            found[0, i] = rigid_displacement(self._tree.points[i : i + 1], *motion)[0]
            if part.rotate:
                axis = np.array(part.rotate.axis) / np.linalg.norm(part.rotate.axis)
                found[1, i] = turn * part.rotate.angle * axis
        return found[0], found[1]

    def rates(self, load: float) -> tuple[Array, Array]:
        """Return the first two time derivatives at a load, (parts, 2, 3) each.

        They are differences of points before the load, so that a kink of an amplitude at it does
        not matter. Rotations are times the unit of length of the part's unknowns.
        """
        h = _SPACING if load <= 0 else -min(_SPACING, load / 4)
        motions = [np.stack(self.at(load + k * h), axis=1) for k in range(len(_FIRST))]
        lengths = np.array([link.length for link in self._tree.links])
        found = []
        for weights, power in ((_FIRST, 1), (_SECOND, 2)):
            change = sum(w * (m - motions[0]) for w, m in zip(weights, motions, strict=True))
            change = change / (h * (self._duration or 1.0)) ** power
            change[:, 1] *= lengths[:, None]
            found.append(change)
        return found[0], found[1]
