"""Parse expressions that users write as text, such as Hill's strain, without evaluating Python.

`why_unbounded` checks them, and those of a user's function, before sympy evaluates them.
"""

from __future__ import annotations

import cmath
import math
import re
from collections.abc import Callable, Mapping
from tokenize import TokenError
from typing import Any

import sympy
from sympy.codegen.cfunctions import log1p
from sympy.parsing.sympy_parser import parse_expr, standard_transformations

from fem_snh.errors import BadInput, bad_value, shown
from fem_snh.materials.functions import positive, where
from fem_snh.materials.parameters import MAX_EXPONENT

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


_EVALUATED: dict[Any, Callable[..., complex]] = {
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
    if part.func in _EVALUATED:
        return complex(_EVALUATED[part.func](*arguments))
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


_FUNCTIONS = {"log": sympy.log, "exp": sympy.exp, "sqrt": sympy.sqrt}
#: The sympy names that the parser's output refers to.
_PARTS = ("Symbol", "Integer", "Float", "Rational", "Add", "Mul", "Pow")
_TOKEN = re.compile(
    r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|(\w+)|(\*\*|[-+*/()]))"
)


#: Longest text, and most digits of a number: a double has 17.
_MAX_LENGTH, _MAX_DIGITS = 1000, 40
#: Values of the measures at rest; of any other symbol 1.
_AT_REST = {"I1": 3.0, "I_C": 3.0, "II_C": 3.0}


def parse(key: str, text: str, symbols: Mapping[str, sympy.Symbol]) -> sympy.Expr:
    """Return ``text`` as a sympy expression in ``symbols``; decimals become exact fractions.

    Parameters
    ----------
    key : str
        The parameter that has the text as its value, for messages.
    text : str
        The expression.
    symbols : mapping
        Its symbols by name.

    Raises
    ------
    BadInput
        For anything but the symbols, numbers, + - * / ** ( ), log, exp and sqrt, and for an
        expression too large to evaluate.
    """
    known = _FUNCTIONS | dict(symbols)
    accepted = f"an expression in {', '.join(symbols)} with numbers, + - * / ** ( ), log, exp, sqrt"

    def mistake(reason: str) -> BadInput:
        return BadInput(f"{key} = {shown(text)}: {reason}: expected {accepted}")

    if not isinstance(text, str):
        raise bad_value(key, text, accepted)
    if len(text) > _MAX_LENGTH:
        raise mistake(f"it has more than {_MAX_LENGTH} characters")
    rest = text.strip()
    while rest:
        token = _TOKEN.match(rest)
        if token is None or (token[2] and token[2] not in known):
            what = token[2] if token else rest[0]
            raise mistake(f"'{what}' is not known")
        if token[1] and not _is_plain_number(token[1]):
            what = f"has more than {_MAX_DIGITS} characters, or is not from 1e-100 to 1e+100"
            raise mistake(f"the number {shown(token[1])[1:-1]} {what}")
        rest = rest[token.end() :].strip()
    names = {"__builtins__": {}} | {part: getattr(sympy, part) for part in _PARTS}
    try:
        found = parse_expr(
            text, dict(known), standard_transformations, global_dict=names, evaluate=False
        )
    except (
        SyntaxError, TypeError, AttributeError, ValueError, NameError, TokenError, MemoryError,
        RecursionError,
    ):  # fmt: skip
        raise mistake("it cannot be read") from None
    if not isinstance(found, sympy.Expr):
        raise mistake("it is not a number")
    values = {symbol: _AT_REST.get(str(symbol), 1.0) for symbol in symbols.values()}
    if reason := why_unbounded(found, values):
        raise mistake(reason)
    return sympy.nsimplify(found.doit(), rational=True)


def _is_plain_number(text: str) -> bool:
    """Return whether a number is one that a double has, 0 or within the bounds of expressions."""
    size = abs(float(text))
    return len(text) <= _MAX_DIGITS and (size == 0 or 1 / LARGEST_NUMBER <= size <= LARGEST_NUMBER)
