"""Symbols of shape parameters."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import sympy


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
