"""UFL forms of a material: what a FEniCSx user writes, from the same expression as the kernels.

The solver uses the kernels, which are faster and never see NaN; these forms are their oracle, the
way to use a material in a program of one's own, and the baseline of
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
    """F = I + grad u as a UFL variable, so that energies can be differentiated by it."""
    return ufl.variable(ufl.Identity(3) + ufl.grad(u))


def energy_density(law: Energy, F: Any) -> Any:
    """psi(F) [Pa] in UFL. NaN where the kernels give +inf.

    Raises BadInput for a material that needs the principal stretches: UFL cannot differentiate
    them where two are equal, as at rest.
    """
    if law.needs_stretches:
        raise BadInput(
            f"material '{law.name}' needs the principal stretches, which UFL cannot "
            "differentiate at rest: use the kernels (fem_snh.material)"
        )
    C = F.T * F
    values = {
        "I_C": ufl.tr(C),
        "II_C": (ufl.tr(C) ** 2 - ufl.tr(C * C)) / 2,
        "J": ufl.det(F),
    }
    return law.evaluate(_FUNCTIONS, *(values[str(m)] for m in law.measures))


def energy(law: Energy, u: Any, dx: Any = ufl.dx) -> Any:
    """The elastic energy of the displacement u [J]."""
    return energy_density(law, deformation_gradient(u)) * dx


def residual(law: Energy, u: Any, v: Any, dx: Any = ufl.dx) -> Any:
    """Its derivative in the direction of the test function v."""
    return ufl.derivative(energy(law, u, dx), u, v)


def jacobian(law: Energy, u: Any, v: Any, w: Any, dx: Any = ufl.dx) -> Any:
    """Its second derivative in the directions of v and the trial function w."""
    return ufl.derivative(residual(law, u, v, dx), u, w)
