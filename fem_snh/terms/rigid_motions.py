"""The prescribed motions of rigid parts, and their rates in time. Not collective."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.geometry.motions import path_rates
from fem_snh.geometry.rigid_tree import RigidTree
from fem_snh.tables.amplitudes import Amplitudes
from fem_snh.terms.rigid import Rigid

Array = npt.NDArray[Any]


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
            found[0, i] = part.displacement(self._tree.points[i : i + 1], amplitude, turn)[0]
            if part.rotate:
                axis = np.array(part.rotate.axis) / np.linalg.norm(part.rotate.axis)
                found[1, i] = turn * part.rotate.angle * axis
        return found[0], found[1]

    def rates(self, load: float, step: float) -> tuple[Array, Array]:
        """Return the first two time derivatives at a load, (parts, 2, 3) each.

        Rotations are times the unit of length of the part's unknowns. See `path_rates`.
        """
        _, *rates = path_rates(lambda at: np.stack(self.at(at), axis=1), load, step)
        for power, rate in enumerate(rates, 1):
            rate /= (self._duration or 1.0) ** power
            rate[:, 1] *= np.array([link.length for link in self._tree.links])[:, None]
        return rates[0], rates[1]
