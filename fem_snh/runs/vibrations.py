"""The modes of vibration that a scene asks for."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fem_snh.runs.setup import Setup
from fem_snh.scenes._outputs import DEFAULT_DENSITY

if TYPE_CHECKING:
    from fem_snh.problem.modes import LowestModes


def vibrations(setup: Setup) -> LowestModes | None:
    """Return what computes the modes of a scene's problem; None if it asks for none. Collective.

    Raises
    ------
    BadInput
        On every rank, for modes that cannot be computed.
    """
    wanted = setup.scene.modes
    if wanted is None:
        return None
    from fem_snh.problem.modes import LowestModes

    modes = LowestModes(wanted.density or DEFAULT_DENSITY, wanted.count)
    modes.check(setup.problem)
    return modes
