"""Choose the energy that an element evaluates: the material's, whole or without its volume term.

`fem_snh.kernels.compiled` calls it before it generates a kernel.
"""

from __future__ import annotations

from typing import NamedTuple

from fem_snh.errors import BadInput
from fem_snh.kernels.codegen import source
from fem_snh.kernels.compiled import ElementConstants
from fem_snh.materials.energy import Energy
from fem_snh.materials.keywords import BOUNDS
from fem_snh.materials.runtime import with_arguments
from fem_snh.materials.volume_split import Split, split


class ElementEnergy(NamedTuple):
    """The energy that the kernels evaluate at quadrature points.

    Attributes
    ----------
    energy : Energy
        The material's energy; for a mixed element psi' + p J of `fem_snh.materials.volume_split`.
    functions : tuple of str
        C functions of the volume term, if it is split off.
    constants : ElementConstants
        The numbers of the energy.
    """

    energy: Energy
    functions: tuple[str, ...]
    constants: ElementConstants


def element_energy(energy: Energy, volume: str) -> ElementEnergy:
    """Return the energy in the form that an element needs.

    Parameters
    ----------
    energy : Energy
        A material's energy.
    volume : str
        The element's volume treatment, one of `fem_snh.assembly.elements`.

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
        made = with_arguments(energy)
        return ElementEnergy(made, (), ElementConstants(made.scalar_values))
    parts = _split_with_arguments(energy, split(energy, BOUNDS[volume]), BOUNDS[volume])
    if volume == "cell_pressure":  # its condensed problem is the faster one
        parts.check_closed_form()
    function = (
        source.volume_energy_function if volume == "mean" else source.volume_conjugate_function
    )
    constants = ElementConstants(parts.energy.scalar_values, parts.stiffness, parts.local)
    return ElementEnergy(parts.energy, (function(parts),), constants)


def _split_with_arguments(energy: Energy, parts: Split, bound: float) -> Split:
    """Return the split of an energy with symbols, if its volume term contains none."""
    made = with_arguments(energy)
    if made is energy:
        return parts
    try:
        found = split(made, bound)
    except BadInput:
        return parts
    return found if found.volume == parts.volume else parts
