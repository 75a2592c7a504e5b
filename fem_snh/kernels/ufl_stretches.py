r"""Energies of the principal stretches as UFL expressions, right at equal stretches.

With the matrix B of `fem_snh.kernels.ufl_frame`, which is diagonal at the point of evaluation,
an isotropic energy is, up to third order in the entries off the diagonal,

.. math::

    \psi(B) = \psi(B_{00}, B_{11}, B_{22})
        + \frac14 \sum_{j<k} \left( \lambda^\mathrm{twist}_{jk} (B_{jk} - B_{kj})^2
        + \lambda^\mathrm{flip}_{jk} (B_{jk} + B_{kj})^2 \right)

with the twist and flip eigenvalues of the Hessian (`fem_snh.kernels.codegen.derivatives`). The
entries off the diagonal are 0 in value. Therefore value, first and second derivative of this
expression are those of the energy, and the derivatives of the eigenvalues do not matter: UFL takes
their stretches for constants.

Third derivatives are not those of the energy. Value and first two derivatives agree with the
kernels to a relative 1e-12 while no stretch is more than 30 times another; beyond, the error grows
as the square of that ratio.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy
import ufl

from fem_snh.kernels.codegen.derivatives import Derivatives
from fem_snh.kernels.ufl_frame import Named, PrincipalFrame
from fem_snh.materials.energy import Energy
from fem_snh.materials.invariants import SIGMA

#: A stretch and the two others, which twist and flip i couple.
_PAIRS = ((0, 1, 2), (1, 0, 2), (2, 0, 1))

#: UFL's functions, by the names that sympy prints.
FUNCTIONS = {
    "log": ufl.ln,
    "log1p": lambda x: ufl.ln(1 + x),
    "exp": ufl.exp,
    "sqrt": ufl.sqrt,
    "where": lambda x, a, b: ufl.conditional(ufl.gt(x, 0), a, b),
}


def off_diagonal_terms(energy: Energy, frame: PrincipalFrame) -> Any:
    """Return the sum over the pairs j < k: 0 in value and first derivative.

    Parameters
    ----------
    energy : Energy
        An energy with ``of_stretches``.
    frame : PrincipalFrame
        The principal frame of the deformation gradient.
    """
    B, s = frame.B, frame.stretches
    eigenvalues = _twist_and_flip(energy)
    total: Any = 0
    for i, j, k in _PAIRS:
        twist, flip = eigenvalues(s[i], s[j], s[k], *energy.values)
        total += Named(twist, f"twist{i}(s)") * (B[j, k] - B[k, j]) ** 2 / 4
        total += Named(flip, f"flip{i}(s)") * (B[j, k] + B[k, j]) ** 2 / 4
    return total


def trace_of_stretch(F: Any) -> Any:
    """Return I1 = tr S, the sum of the signed stretches, as a UFL expression.

    Its twist eigenvalues are 2/(s_j + s_k), its flip eigenvalues 0.
    """
    frame = PrincipalFrame(F)
    B, s = frame.B, frame.stretches
    twists = ((B[j, k] - B[k, j]) ** 2 / 2 * _inverse_sum(s[j], s[k]) for _, j, k in _PAIRS)
    return ufl.tr(B) + sum(twists)


def _twist_and_flip(energy: Energy) -> Any:
    """Return a function of the stretches (s_i, s_j, s_k) and the constants: (twist_i, flip_i)."""
    derivatives = Derivatives(energy)
    pair: Sequence[sympy.Expr] = derivatives.twist_and_flip(*SIGMA)
    expanded = [sympy.sympify(x).xreplace(derivatives.derivatives) for x in pair]
    arguments = (*SIGMA, *energy.constants)
    return sympy.lambdify(arguments, expanded, modules=_FROZEN_FUNCTIONS, cse=True)


# --- functions of kernels/include/divided_differences.h and log_exp_series.h, in UFL ------------


def _quotient(numerator: Any, denominator: Any, partner: Any, divided: Any) -> Any:
    close = ufl.le(abs(denominator), 0.1 * abs(partner))
    return ufl.conditional(close, divided, numerator / ufl.conditional(close, 1.0, denominator))


def _inverse_sum(a: Any, b: Any) -> Any:
    return 1 / ufl.max_value(a + b, 1e-15 * (abs(a) + abs(b)) + 1e-30)


def _log1p_over_x(x: Any) -> Any:
    x = ufl.variable(x)
    z = ufl.variable(x / (2 + x))
    w = ufl.variable(z * z)
    total: Any = 1.0 / 19
    for n in range(17, 0, -2):
        total = total * w + 1.0 / n
    small = ufl.le(abs(x), 0.25)
    y = ufl.variable(ufl.conditional(small, 1.0, x))
    return ufl.conditional(small, 2 * total / (2 + x), ufl.ln(1 + y) / y)


def _expm1_over_x(x: Any) -> Any:
    x = ufl.variable(x)
    total: Any = 1.0
    for n in range(14, 1, -1):
        total = 1 + total * x / n
    small = ufl.le(abs(x), 0.5)
    y = ufl.variable(ufl.conditional(small, 1.0, x))
    return ufl.conditional(small, total, (ufl.exp(y) - 1) / y)


def _powm1_over_x(x: Any, a: Any) -> Any:
    quotient = ufl.variable(a * _log1p_over_x(x))
    return quotient * _expm1_over_x(quotient * x)


_FROZEN_FUNCTIONS = FUNCTIONS | {
    "quotient": _quotient,
    "inverse_sum": _inverse_sum,
    "log1p_over_x": _log1p_over_x,
    "expm1_over_x": _expm1_over_x,
    "powm1_over_x": _powm1_over_x,
}
