"""The modes of vibration that a scene asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fem_snh.problem.problem import Problem
from fem_snh.scenes import Scene
from fem_snh.scenes._outputs import DEFAULT_DENSITY

if TYPE_CHECKING:
    from fem_snh.problem.modes import LowestModes


def vibrations(scene: Scene, problem: Problem) -> LowestModes | None:
    """Return what computes the modes of a scene's problem; None if it asks for none. Collective.

    Raises
    ------
    BadInput
        On every rank, for modes that cannot be computed.
    """
    if scene.modes is None:
        return None
    from fem_snh.problem.modes import LowestModes

    modes = LowestModes(scene.modes.density or DEFAULT_DENSITY, scene.modes.count)
    modes.check(problem)
    return modes
