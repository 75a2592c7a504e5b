"""UFL forms of a material, from the same expression as the compiled kernels.

The solver uses the kernels, which are faster and never produce NaN. The forms serve programs that
use a material with dolfinx's assemblers, as a reference in tests, and as the baseline of
``python -m benchmarks assembly``.
"""

from __future__ import annotations

from typing import Any

import sympy
import ufl

from fem_snh.errors import BadInput
from fem_snh.kernels.ufl_frame import PrincipalFrame
from fem_snh.kernels.ufl_stretches import FUNCTIONS, off_diagonal_terms, trace_of_stretch
from fem_snh.materials.energy import Energy


def deformation_gradient(u: Any) -> Any:
    """Return F = I + grad u as a UFL variable, with respect to which energies can be derived."""
    return ufl.variable(ufl.Identity(3) + ufl.grad(u))


def energy_density(energy: Energy, F: Any) -> Any:
    """Return the energy density psi(F) [Pa] as a UFL expression.

    It is NaN where the kernels return +inf.

    Parameters
    ----------
    energy : Energy
        A material's energy: ``material(...).expression``.
    F : UFL expression
        The (3, 3) deformation gradient.

    Raises
    ------
    BadInput
        For a material that has a stress but no energy.

    Notes
    -----
    An energy of the invariants I_C, II_C and J is written in F itself. Energies of the principal
    stretches, and of I1, their sum, have the form of `fem_snh.kernels.ufl_stretches`.
    """
    if not energy.has_energy:
        raise BadInput(f"material '{energy.name}' has no energy, only a stress")
    rest: Any = 0
    if energy.of_stretches:
        frame = PrincipalFrame(F)
        measures = [frame.B[i, i] for i in range(3)]
        rest = off_diagonal_terms(energy, frame)
    else:
        measures = [_INVARIANTS[str(m)](F) for m in energy.measures]
    for barrier in energy.barriers:
        inside = sympy.lambdify(energy.measures, barrier, modules=FUNCTIONS)(*measures)
        rest += ufl.ln(ufl.conditional(ufl.gt(inside, 0), 1.0, -1.0))  # 0 inside, NaN outside
    return energy.evaluate(FUNCTIONS, *measures) + rest


def _area(F: Any) -> Any:
    C = F.T * F
    return (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2


_INVARIANTS = {
    "I1": trace_of_stretch,
    "I_C": lambda F: ufl.tr(F.T * F),
    "II_C": _area,
    "J": ufl.det,
}


def elastic_energy(energy: Energy, u: Any, dx: Any = ufl.dx) -> Any:
    """Return the form of the elastic energy [J] of the displacement u."""
    return energy_density(energy, deformation_gradient(u)) * dx


def residual(energy: Energy, u: Any, v: Any, dx: Any = ufl.dx) -> Any:
    """Return the derivative of the elastic energy in the direction of the test function v."""
    return ufl.derivative(elastic_energy(energy, u, dx), u, v)


def jacobian(energy: Energy, u: Any, v: Any, w: Any, dx: Any = ufl.dx) -> Any:
    """Return the second derivative in the directions of v and of the trial function w."""
    return ufl.derivative(residual(energy, u, v, dx), u, w)
