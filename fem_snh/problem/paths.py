"""Paths of steps along which parts of a body turn, instead of growing."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.regions import Region
from fem_snh.problem.stiff_parts import StiffParts

if TYPE_CHECKING:
    from fem_snh.terms.rigid_parts import RigidParts


class Paths:
    """The paths of all nodes: of stiff parts, of rigid parts, and straight ones. Collective.

    Parameters
    ----------
    stiff : StiffParts or None
    rigid : RigidParts or None

    Attributes
    ----------
    exact : bool
        Whether steps must end on the path: a straight step would deform rigid parts.
    """

    def __init__(self, stiff: StiffParts | None, rigid: RigidParts | None) -> None:
        self._stiff, self._rigid, self.exact = stiff, rigid, rigid is not None

    @classmethod
    def of(
        cls,
        V: Any,
        regions: Sequence[Region],
        fixed: npt.NDArray[np.bool_],
        excluded: npt.NDArray[np.bool_],
        rigid: RigidParts | None,
    ) -> Paths | None:
        """Return the paths of a problem; None if all are straight. Collective.

        The first parameters are those of `StiffParts.of`.
        """
        stiff = StiffParts.of(V, regions, fixed, excluded)
        return cls(stiff, rigid) if stiff or rigid else None

    def __call__(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set ``end`` to the end of the path from x along step d."""
        if self._stiff:
            self._stiff(x, d, step, end)
        else:
            end.waxpy(step, d, x)
        if self._rigid:
            self._rigid.move(x, d, step, end)

    def move_rigidly(self, start: PETSc.Vec, x: PETSc.Vec) -> None:
        """Replace the motion of stiff and rigid parts by the nearest rigid one, in place."""
        if self._stiff:
            self._stiff.move_rigidly(start, x)
        if self._rigid:
            self._rigid.move_rigidly(x)
