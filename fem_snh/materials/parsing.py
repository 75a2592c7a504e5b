"""Parse expressions that users write as text, such as Hill's strain, without evaluating Python."""

from __future__ import annotations

import re
from collections.abc import Mapping
from tokenize import TokenError

import sympy
from sympy.parsing.sympy_parser import parse_expr, standard_transformations

from fem_snh.errors import BadInput, bad_value, shown
from fem_snh.materials.bounds import LARGEST_NUMBER, why_unbounded

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
