"""An energy as an element takes it: whole, or with its volume term apart."""

from __future__ import annotations

from typing import NamedTuple

from fem_snh.errors import BadInput
from fem_snh.kernels.codegen import source
from fem_snh.materials.energy import Energy
from fem_snh.materials.volume_split import BOUNDS, split


class ElementEnergy(NamedTuple):
    """What the kernels evaluate: an energy, and C functions for its volume term if it is apart."""

    energy: Energy
    functions: tuple[str, ...] = ()
    volume_stiffness: float = 0.0  # U''(1) [Pa]
    lambda_local: float = 0.0  # lambda_local [Pa], what is left of lambda


def element_energy(energy: Energy, volume: str) -> ElementEnergy:
    """The energy as an element with this volume treatment takes it.

    Raises BadInput for an energy that it cannot take.
    """
    if volume == "pointwise":
        if energy.incompressible:
            raise BadInput(
                f"nu = 0.5: material '{energy.name}' is incompressible, which takes a Taylor-Hood "
                "element (P2P1, Q2Q1)"
            )
        return ElementEnergy(energy)
    parts = split(energy, BOUNDS[volume])
    curve = source.volume_curve if volume == "mean" else source.volume_dual
    return ElementEnergy(parts.energy, (curve(parts),), parts.stiffness, parts.local)
