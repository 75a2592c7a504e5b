"""Choose the energy that an element evaluates: the material's, whole or without its volume term.

`fem_snh.fem.terms.elastic` and `fem_snh.kernels.pointwise` call it before they compile a kernel.
"""

from __future__ import annotations

from typing import NamedTuple

from fem_snh.errors import BadInput
from fem_snh.kernels.codegen import source
from fem_snh.materials.energy import Energy
from fem_snh.materials.volume_split import BOUNDS, split


class ElementEnergy(NamedTuple):
    """The energy that the kernels evaluate at quadrature points.

    Attributes
    ----------
    energy : Energy
        The material's energy; for a mixed element psi' + p J of `fem_snh.materials.volume_split`.
    functions : tuple of str
        C functions of the volume term, if it is split off.
    volume_stiffness : float
        U''(1) of the volume term that is split off [Pa], or 0.
    lambda_local : float
        The Lame constant lambda that remains in psi' [Pa], or 0 if nothing is split off.
    """

    energy: Energy
    functions: tuple[str, ...] = ()
    volume_stiffness: float = 0.0
    lambda_local: float = 0.0


def element_energy(energy: Energy, volume: str) -> ElementEnergy:
    """Return the energy in the form that an element needs.

    Parameters
    ----------
    energy : Energy
        A material's energy.
    volume : str
        The element's volume treatment: "pointwise", "mean" or "pressure".

    Raises
    ------
    BadInput
        If the element cannot use the energy: nu = 0.5 without a pressure, or a volume term that
        cannot be split off.
    """
    if volume == "pointwise":
        if energy.incompressible:
            raise BadInput(
                f"nu = 0.5: material '{energy.name}' is incompressible and requires a Taylor-Hood "
                "element (P2P1, Q2Q1)"
            )
        return ElementEnergy(energy)
    parts = split(energy, BOUNDS[volume])
    function = (
        source.volume_energy_function if volume == "mean" else source.volume_conjugate_function
    )
    return ElementEnergy(parts.energy, (function(parts),), parts.stiffness, parts.local)
