"""Values of loads that a program gives as UFL expressions."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import ufl
from ufl.algorithms import extract_coefficients
from ufl.constantvalue import ConstantValue
from ufl.core.multiindex import MultiIndex
from ufl.corealg.traversal import traverse_unique_terminals

from fem_snh.errors import bad_value
from fem_snh.tables.validation import is_expression

#: Parts of an expression that has the same value at all points.
_UNIFORM = (ufl.Constant, ConstantValue, MultiIndex)


def is_uniform(value: Any) -> bool:
    """Return whether a value is the same at all points: numbers, or an expression of Constants."""
    return not is_expression(value) or all(
        isinstance(part, _UNIFORM) for part in traverse_unique_terminals(value)
    )


def present(value: Any) -> npt.NDArray[np.float64]:
    """Return the present numbers of a value that is uniform, with the shape of its expression."""
    if not is_expression(value):
        return np.asarray(value, dtype=float)
    constants = [c for c in traverse_unique_terminals(value) if isinstance(c, ufl.Constant)]
    numbers = {c: np.asarray(c.value) for c in constants}  # type: ignore[attr-defined]
    found = np.empty(value.ufl_shape)
    for index in np.ndindex(found.shape):
        found[index] = value((), numbers, index)
    return found


def check_expression(key: str, value: Any, u: Any, size: int = 1) -> None:
    """Raise BadInput for a UFL expression of another size, or of the displacement ``u``.

    Parameters
    ----------
    key : str
        The key that has the value, for messages.
    value : UFL expression
        The value, of rank 0 or 1.
    u : dolfinx Function
        The displacement.
    size : int
        Number of components of a vector.
    """
    if value.ufl_shape not in ((), (size,)):
        raise bad_value(key, f"a vector of {value.ufl_shape[0]}", f"{size} components")
    if u in extract_coefficients(value):
        accepted = "no displacement in it: forces that depend on it are forms of 'terms'"
        raise bad_value(key, value, accepted)
