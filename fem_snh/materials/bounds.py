"""Bounds of the expressions that users write, checked before sympy evaluates them."""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable, Mapping
from typing import Any

import sympy
from sympy.codegen.cfunctions import log1p

from fem_snh.materials.functions import positive, where
from fem_snh.materials.keywords import MAX_EXPONENT

#: Largest number, and the inverse of the smallest one: products with moduli and stretches, and
#: derivatives, stay in the range of double precision.
LARGEST_NUMBER = 1e100
#: Most operations and symbols, repeated ones counted again. The longest built-in energy, the filter
#: of `filtered_neo_hookean` on the volume, has some thousands.
MAX_SIZE = 50_000


def _exponential(x: complex) -> complex:
    """Return exp(x); raise OverflowError where it would underflow."""
    if x.real < -math.log(LARGEST_NUMBER):
        raise OverflowError
    return cmath.exp(x)


_FUNCTIONS: dict[Any, Callable[..., complex]] = {
    sympy.log: cmath.log,
    log1p: lambda x: cmath.log(1 + x),
    sympy.exp: _exponential,
    positive: lambda x: x,
    where: lambda x, a, b: a if x.real > 0 else b,
}


def why_unbounded(expression: sympy.Expr, values: Mapping[sympy.Symbol, float]) -> str:
    """Return what makes an expression too large to evaluate; empty if it is not.

    Its numbers, evaluated in double precision, and its values at rest must be smaller than
    `LARGEST_NUMBER`, and its degree, the product of nested exponents, at most `MAX_EXPONENT`:
    otherwise exact integers of millions of digits follow, and polynomials of as many terms.

    Parameters
    ----------
    expression : sympy.Expr
        The expression; it may be unevaluated, and is not evaluated here.
    values : mapping
        The values at rest of the measures in it; other symbols have the value 1.
    """
    degree: dict[sympy.Basic, float] = {}
    size: dict[sympy.Basic, complex] = {}
    count = 0
    for part in sympy.postorder_traversal(expression):  # the parts of a part come before it
        count += 1
        if count > MAX_SIZE:
            return f"it has more than {MAX_SIZE} operations"
        if part in size:
            continue
        if part.is_Pow and abs(size[part.args[1]]) > MAX_EXPONENT:
            return f"an exponent is beyond {MAX_EXPONENT}"
        try:
            size[part] = _value(part, [size[a] for a in part.args], values)
        except OverflowError:
            size[part] = math.inf
        except (ValueError, ZeroDivisionError):  # singular at rest: other checks are about that
            size[part] = math.nan
        modulus = abs(size[part])
        if modulus > LARGEST_NUMBER or 0 < modulus < 1 / LARGEST_NUMBER:
            return f"a value is beyond {LARGEST_NUMBER:g}, or below its inverse"
        degree[part] = _degree(part, [degree[a] for a in part.args], size, values)
        if degree[part] > MAX_EXPONENT:
            return f"its degree is beyond {MAX_EXPONENT}"
    return ""


def _value(
    part: sympy.Basic, arguments: list[complex], values: Mapping[sympy.Symbol, float]
) -> complex:
    """Return the value of a part, from those of its arguments."""
    if part.is_Symbol:
        return complex(values.get(part, 1.0))
    if part.is_Number or part.is_NumberSymbol:
        return complex(float(part))
    if part.is_Add:
        return sum(arguments)
    if part.is_Mul:
        return _product(arguments)
    if part.is_Pow:
        return _power(*arguments)
    if part.func in _FUNCTIONS:
        return complex(_FUNCTIONS[part.func](*arguments))
    return math.nan


def _product(factors: list[complex]) -> complex:
    """Return a product; raise OverflowError where Python's complex numbers would become NaN."""
    found: complex = 1.0
    for factor in factors:
        found *= factor
        if abs(found) > LARGEST_NUMBER**2:
            raise OverflowError
    return found


def _power(base: complex, exponent: complex) -> complex:
    """Return a power; raise OverflowError where Python's complex numbers would become NaN."""
    if base != 0 and exponent.real * math.log(abs(base)) > math.log(LARGEST_NUMBER) + 1:
        raise OverflowError
    return base**exponent


def _degree(
    part: sympy.Basic,
    degrees: list[float],
    size: Mapping[sympy.Basic, complex],
    measures: Mapping[sympy.Symbol, float],
) -> float:
    """Return the degree of a part as a polynomial in the measures, from those of its arguments."""
    if part.is_Symbol:
        return float(part in measures)
    if part.is_Mul:
        return sum(degrees)
    if part.is_Pow:
        return max(abs(size[part.args[1]]), 1.0) * degrees[0]
    return max(degrees, default=0.0)
