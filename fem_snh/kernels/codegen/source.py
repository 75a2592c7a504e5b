"""Choose the energy that an element evaluates at points, and assemble its C source.

It is the material's energy, whole or without its volume term. `fem_snh.kernels.material` and
``fem-snh materials NAME --source`` call this module.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import sympy
from sympy.codegen.cfunctions import expm1

from fem_snh.errors import BadInput
from fem_snh.kernels.build import MATERIAL_FUNCTIONS, POINTWISE, header, svd_eigen_declarations
from fem_snh.kernels.codegen.c_functions import Functions, Writer
from fem_snh.kernels.codegen.small_strain import (
    VOLUME_INCREMENT,
    Increments,
    SmallStrainFunctions,
    small_strain_forms,
)
from fem_snh.kernels.material import ElementConstants
from fem_snh.materials.energy import Energy
from fem_snh.materials.parameters import BOUNDS
from fem_snh.materials.volume_split import PRESSURE, J, Split, split

#: Headers that precede the generated functions and define what these call.
_BEFORE = ("log_exp_series.h", "divided_differences.h", *MATERIAL_FUNCTIONS)
#: The file that calls the generated functions.
_POINT = "material_point.h"


def material_source(energy: Energy) -> str:
    """Return the C source of a material's pointwise kernels: energy, stress, Hessian, eigensystem.

    Parameters
    ----------
    energy : Energy
        A normalised energy; ``fem_snh.materials.make_energy(name, E, nu)`` makes one.
    """
    return "\n".join([point_source(energy), *map(header, POINTWISE)])


def point_source(energy: Energy, entries: Sequence[int] = (), functions: Sequence[str] = ()) -> str:
    """Return the C source of the functions in material_functions.h for one energy.

    Parameters
    ----------
    energy : Energy
        A normalised energy.
    entries : sequence of int
        The entries of vec(F) that vary in the element's kinematics; () for all nine.
    functions : sequence of str
        The generated C functions of the element's volume term.
    """
    regular, small = Functions(energy), SmallStrainFunctions(energy)
    generated = [
        regular.energy_function("s"),
        regular.gradient_function(),
        regular.hessian_function(),
    ]
    if energy.needs_stretches:
        generated += [small.energy_function(), small.gradient_function()]
    else:
        generated += [regular.energy_function("F"), regular.stress_function()]
        generated += [small.energy_function(), small.stress_function()]
    return "\n".join(
        [
            "#include <math.h>",
            *([f"#define ENTRIES {', '.join(map(str, entries))}"] if entries else []),
            f"#define NEEDS_STRETCHES {int(energy.needs_stretches)}",
            f"#define USES_J {int(J in energy.measures)}",
            svd_eigen_declarations(),
            *map(header, _BEFORE),
            f"/* generated: {energy.name}, psi = {energy.psi} */",
            *generated,
            *functions,
            header(_POINT),
        ]
    )


def volume_energy_function(split: Split) -> str:
    """Return the C function of (U(J), U', U'') [Pa] that volume_mean.h calls."""
    head = f"volume_energy(Parameters p, real J, real {VOLUME_INCREMENT}, real *U)"
    curve = split.volume_curve
    return Writer(split.energy).curve_function(head, J, curve, "U", small_strain_forms(curve))


def volume_conjugate_function(split: Split) -> str:
    """Return the C function of (U*(p), dU*/dp - 1, d2U*/dp2) that volume_pressure.h calls."""
    head, curve = "volume_conjugate(Parameters p, real *conjugate)", split.dual_curve
    ratio = curve[1]  # 1 at p = 0
    if isinstance(ratio, sympy.exp):
        increment = expm1(ratio.args[0])
    else:
        increment = Increments({PRESSURE: (sympy.Integer(0), PRESSURE)})(ratio)[1]
    forms = [curve[0], increment, curve[2]]
    return Writer(split.energy).curve_function(head, PRESSURE, curve, "conjugate", forms)


class ElementEnergy(NamedTuple):
    """The energy that the kernels evaluate at quadrature points.

    Attributes
    ----------
    energy : Energy
        The material's energy; for a mixed element psi' + p J of `fem_snh.materials.volume_split`.
    functions : tuple of str
        C functions of the volume term; () if it is not split off.
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
        If the element cannot use the energy: nu = 0.5 without an unknown pressure, or a volume term
        that cannot be split off or has no closed-form conjugate.
    """
    if volume == "pointwise":
        if energy.incompressible:
            raise BadInput(
                f"nu = 0.5: material '{energy.name}' is incompressible and requires a Taylor-Hood "
                "element (P2P1, Q2Q1)"
            )
        return ElementEnergy(energy, (), ElementConstants(energy.values))
    parts = split(energy, BOUNDS[volume])
    if volume == "cell_pressure":  # for (log J)^2 the condensed problem, "mean", is faster
        parts.check_closed_form()
    function = volume_energy_function if volume == "mean" else volume_conjugate_function
    constants = ElementConstants(parts.energy.values, parts.stiffness, parts.local)
    return ElementEnergy(parts.energy, (function(parts),), constants)
