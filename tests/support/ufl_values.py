"""Values of UFL expressions with numpy, at many points in one evaluation.

UFL's own ``expression(point)`` follows every path through the expression, of which there are more
than 10^20 in an energy of the stretches. Here each subexpression is evaluated once.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import ufl
from ufl import classes
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives

_FUNCTIONS = {
    "sqrt": np.sqrt, "exp": np.exp, "ln": np.log, "cos": np.cos, "acos": np.arccos,
    "abs": np.abs, "sign": np.sign, "min_value": np.minimum, "max_value": np.maximum,
    "division": np.divide, "power": np.power, "sum": np.add, "product": np.multiply,
    "lt": np.less, "gt": np.greater, "le": np.less_equal, "ge": np.greater_equal,
    "real": np.asarray, "conj": np.asarray,
}  # fmt: skip

Indices = dict[int, int]


def value(expression: Any, points: dict[Any, np.ndarray]) -> np.ndarray:
    """The values (n, *shape) of an expression where its terminals have the (n, *shape) values."""
    return Values(points)(_expanded(expression))


def energy_and_derivatives(psi: Any, variable: Any, points: dict[Any, np.ndarray]) -> list[Any]:
    """psi (n,), UFL's first (n, 3, 3) and second derivative (n, 3, 3, 3, 3) by a UFL variable.

    ``points`` gives the (n, *shape) values of the terminals.
    """
    P = _expanded(ufl.diff(psi, variable))
    values = Values(points)
    return [values(e) for e in (_expanded(psi), P, _expanded(ufl.diff(P, variable)))]


def _expanded(expression: Any) -> Any:
    return apply_derivatives(apply_algebra_lowering(expression))


class Values:
    """Values of expanded expressions of terminals with the values ``points``."""

    def __init__(self, points: dict[Any, np.ndarray]) -> None:
        self._points = points
        self._known: dict[Any, tuple[Any, Any]] = {}

    def __call__(self, e: Any) -> np.ndarray:
        """(n, *shape)."""
        with np.errstate(all="ignore"):
            found = [self._value(e, c, {}) for c in np.ndindex(*e.ufl_shape)]
        return np.stack(np.broadcast_arrays(*found), axis=-1).reshape(-1, *e.ufl_shape)

    def _value(self, e: Any, component: tuple[int, ...], at: Indices) -> Any:
        key = (id(e), component, tuple(at[i] for i in e.ufl_free_indices))
        if key not in self._known:
            self._known[key] = self._compute(e, component, at), e  # its address stays its own
        return self._known[key][0]

    def _compute(self, e: Any, c: tuple[int, ...], at: Indices) -> Any:
        if e._ufl_is_terminal_:
            return self._terminal(e, c)
        ops = e.ufl_operands
        if isinstance(e, classes.Variable):
            return self._value(ops[0], c, at)
        if isinstance(e, classes.Indexed):
            return self._value(ops[0], tuple(_number(i, at) for i in ops[1]), at)
        if isinstance(e, classes.ComponentTensor):
            own = {i.count(): n for i, n in zip(ops[1], c, strict=True)}
            return self._value(ops[0], (), at | own)
        if isinstance(e, classes.ListTensor):
            return self._value(ops[c[0]], c[1:], at)
        if isinstance(e, classes.IndexSum):
            i = ops[1][0].count()
            return sum(self._value(ops[0], c, at | {i: n}) for n in range(e.dimension()))
        if isinstance(e, classes.Conditional):
            return np.where(self._value(ops[0], (), at), *(self._value(x, c, at) for x in ops[1:]))
        values = [self._value(x, c if x.ufl_shape else (), at) for x in ops]
        return _FUNCTIONS[e._ufl_handler_name_](*values)

    def _terminal(self, e: Any, c: tuple[int, ...]) -> Any:
        if isinstance(e, classes.Zero):
            return np.zeros(1)
        if isinstance(e, classes.ScalarValue):
            return np.full(1, float(e._value))
        if isinstance(e, classes.Identity):
            return np.full(1, float(c[0] == c[1]))
        return self._points[e][(slice(None), *c)]


def _number(index: Any, at: Indices) -> int:
    return int(index) if isinstance(index, classes.FixedIndex) else at[index.count()]
