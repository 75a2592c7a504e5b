"""UFL forms of a material, from the same expression as the compiled kernels.

The solver uses the kernels, which are faster and never produce NaN. The forms serve programs that
use a material with dolfinx's assemblers, as a reference in tests, and as the baseline of
``python -m benchmarks assembly``.
"""

from __future__ import annotations

from typing import Any

import ufl

from fem_snh.errors import BadInput
from fem_snh.materials.energy import Energy

_FUNCTIONS = {
    "log": ufl.ln,
    "exp": ufl.exp,
    "sqrt": ufl.sqrt,
    "where": lambda x, a, b: ufl.conditional(ufl.gt(x, 0), a, b),
}


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
        For an energy of the principal stretches. UFL cannot differentiate these where two are
        equal, as in the undeformed state.
    """
    if energy.needs_stretches:
        raise BadInput(
            f"material '{energy.name}' needs the principal stretches, which UFL cannot "
            "differentiate at rest: use the kernels (fem_snh.material)"
        )
    C = F.T * F
    values = {
        "I_C": ufl.tr(C),
        "II_C": (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2,
        "J": ufl.det(F),
    }
    return energy.evaluate(_FUNCTIONS, *(values[str(m)] for m in energy.measures))


def elastic_energy(energy: Energy, u: Any, dx: Any = ufl.dx) -> Any:
    """Return the form of the elastic energy [J] of the displacement u."""
    return energy_density(energy, deformation_gradient(u)) * dx


def residual(energy: Energy, u: Any, v: Any, dx: Any = ufl.dx) -> Any:
    """Return the derivative of the elastic energy in the direction of the test function v."""
    return ufl.derivative(elastic_energy(energy, u, dx), u, v)


def jacobian(energy: Energy, u: Any, v: Any, w: Any, dx: Any = ufl.dx) -> Any:
    """Return the second derivative in the directions of v and of the trial function w."""
    return ufl.derivative(residual(energy, u, v, dx), u, w)
