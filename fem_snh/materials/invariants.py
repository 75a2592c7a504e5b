"""Deformation measures, as functions of the principal stretches.

``I1``   = sum sigma_i, the trace of the stretch tensor S (polar decomposition F = R S)
``I_C``  = sum sigma_i^2 = tr C
``II_C`` = (I_C^2 - tr C^2)/2 = sum of (sigma_i sigma_j)^2, the second invariant of C
``J``    = sigma_0 sigma_1 sigma_2 = det F
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import sympy

#: The signed principal stretches of the rotation-variant SVD (Smith et al. 2018, eq. 2).
SIGMA = sympy.symbols("s0 s1 s2", real=True)

_s0, _s1, _s2 = SIGMA
_I1, _J = sympy.symbols("I1 J", real=True)
_I_C, _II_C = sympy.symbols("I_C II_C", nonnegative=True)

#: Each invariant's symbol and its expression in the stretches.
INVARIANTS: dict[sympy.Symbol, sympy.Expr] = {
    _I1: _s0 + _s1 + _s2,
    _I_C: _s0**2 + _s1**2 + _s2**2,
    _II_C: (_s0 * _s1) ** 2 + (_s0 * _s2) ** 2 + (_s1 * _s2) ** 2,
    _J: _s0 * _s1 * _s2,
}

#: The measures that a material function may have as arguments, by name.
MEASURES: dict[str, sympy.Symbol] = {str(m): m for m in (*INVARIANTS, *SIGMA)}


class Parameter(sympy.Symbol):  # type: ignore[misc]  # sympy has no annotations
    """The symbol of a shape parameter."""


def parameters_in(values: Iterable[Any]) -> set[sympy.Symbol]:
    """Return the symbols of shape parameters in expressions and in tuples of them."""
    found: set[sympy.Symbol] = set()
    for value in values:
        if isinstance(value, tuple | list):
            found |= parameters_in(value)
        elif isinstance(value, sympy.Basic):
            found |= value.atoms(Parameter)
    return found
