"""Parse expressions that users write as text, such as Hill's strain, without evaluating Python."""

from __future__ import annotations

import re
from collections.abc import Mapping
from tokenize import TokenError

import sympy
from sympy.parsing.sympy_parser import parse_expr, standard_transformations

from fem_snh.errors import BadInput
from fem_snh.materials.keywords import MAX_EXPONENT

_FUNCTIONS = {"log": sympy.log, "exp": sympy.exp, "sqrt": sympy.sqrt}
#: The sympy names that the parser's output refers to.
_PARTS = ("Symbol", "Integer", "Float", "Rational", "Add", "Mul", "Pow")
_TOKEN = re.compile(
    r"\s*(?:(\d+\.?\d*(?:[eE][+-]?\d+)?|\.\d+(?:[eE][+-]?\d+)?)|(\w+)|(\*\*|[-+*/()]))"
)


def parse(text: str, symbols: Mapping[str, sympy.Symbol]) -> sympy.Expr:
    """Return ``text`` as a sympy expression in ``symbols``; decimals become exact fractions.

    Raises
    ------
    BadInput
        For anything but the symbols, numbers, + - * / ** ( ), log, exp and sqrt.
    """
    known = _FUNCTIONS | dict(symbols)
    accepted = f"an expression in {', '.join(symbols)} with numbers, + - * / ** ( ), log, exp, sqrt"
    rest = str(text).strip()
    while rest:
        token = _TOKEN.match(rest)
        if token is None or (token[2] and token[2] not in known):
            what = token[2] if token else rest[0]
            raise BadInput(f"{text!r}: '{what}' is not known: expected {accepted}")
        rest = rest[token.end() :].strip()
    names = {"__builtins__": {}} | {part: getattr(sympy, part) for part in _PARTS}
    try:
        found = parse_expr(
            str(text), dict(known), standard_transformations, global_dict=names, evaluate=False
        )
    except (SyntaxError, TypeError, AttributeError, ValueError, NameError, TokenError):
        raise BadInput(f"{text!r} cannot be read: expected {accepted}") from None
    if not isinstance(found, sympy.Expr):
        raise BadInput(f"{text!r} is not a number: expected {accepted}")
    for part in sympy.postorder_traversal(found):  # the parts of a part come before it
        if part.is_Pow and part.exp.is_number and abs(float(part.exp.doit())) > MAX_EXPONENT:
            raise BadInput(f"{text!r}: an exponent is beyond {MAX_EXPONENT}: expected {accepted}")
    return sympy.nsimplify(found.doit(), rational=True)
