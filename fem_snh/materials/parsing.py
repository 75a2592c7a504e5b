"""Parse expressions that users write as text, such as Hill's strain, without evaluating Python."""

from __future__ import annotations

import ast
import operator
from collections.abc import Callable, Mapping

import sympy

from fem_snh.errors import BadInput, bad_value, shown
from fem_snh.materials.parameters import MAX_EXPONENT

#: Largest number, and the inverse of the smallest: products with moduli and stretches, and
#: derivatives, stay in the range of double precision.
_LARGEST_NUMBER = 1e100
#: Longest text: nested exponents of a longer one give polynomials that sympy expands for hours.
_MAX_LENGTH = 1000
#: Values of the measures at rest. The value of any other symbol is 1.
_AT_REST = {"I1": 3, "I_C": 3, "II_C": 3}
_FUNCTIONS = {"log": sympy.log, "exp": sympy.exp, "sqrt": sympy.sqrt}
_OPERATORS: dict[type[ast.AST], Callable[..., sympy.Expr]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: operator.pow,
    ast.UAdd: operator.pos,
    ast.USub: operator.neg,
}


def parse(key: str, text: str, symbols: Mapping[str, sympy.Symbol]) -> sympy.Expr:
    """Return ``text`` as a sympy expression in ``symbols``; decimals become exact fractions.

    Parameters
    ----------
    key : str
        The parameter whose value is the text, for messages.
    text : str
        The expression.
    symbols : mapping
        The accepted symbols by name.

    Raises
    ------
    BadInput
        For anything but the symbols, numbers, + - * / ** ( ), log, exp and sqrt, for a text of more
        than 1000 characters, an exponent beyond `MAX_EXPONENT`, and a value at rest that is too
        large or too small.
    """
    accepted = f"an expression in {', '.join(symbols)} with numbers, + - * / ** ( ), log, exp, sqrt"
    if not isinstance(text, str):
        raise bad_value(key, text, accepted)
    rest = {symbol: _AT_REST.get(name, 1) for name, symbol in symbols.items()}

    def evaluate(node: ast.AST) -> sympy.Expr:
        found = checked(node)
        size = abs(found.subs(rest).evalf())
        if size.is_Float and size and not 1 / _LARGEST_NUMBER <= size <= _LARGEST_NUMBER:
            raise ValueError(f"a value is beyond {_LARGEST_NUMBER:g}, or below its inverse")
        return found

    def checked(node: ast.AST) -> sympy.Expr:
        if isinstance(node, ast.Name) and node.id in symbols:
            return symbols[node.id]
        if isinstance(node, ast.Constant) and type(node.value) in (int, float):
            return sympy.Rational(str(node.value))
        if isinstance(node, ast.UnaryOp) and type(node.op) in _OPERATORS:
            return _OPERATORS[type(node.op)](evaluate(node.operand))
        if isinstance(node, ast.BinOp) and type(node.op) in _OPERATORS:
            left, right = evaluate(node.left), evaluate(node.right)
            if isinstance(node.op, ast.Pow):
                _check_exponent(left, right)
            return _OPERATORS[type(node.op)](left, right)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            if node.func.id in _FUNCTIONS and len(node.args) == 1 and not node.keywords:
                return _FUNCTIONS[node.func.id](evaluate(node.args[0]))
        raise ValueError(f"'{ast.unparse(node)}' is not known")

    try:
        if len(text) > _MAX_LENGTH:
            raise ValueError(f"it has more than {_MAX_LENGTH} characters")
        return evaluate(ast.parse(text.strip(), mode="eval").body)
    except (SyntaxError, TypeError, MemoryError, RecursionError):
        reason = "it cannot be read"
    except ValueError as error:
        reason = str(error)
    raise BadInput(f"{key} = {shown(text)}: {reason}: expected {accepted}")


def _check_exponent(base: sympy.Expr, exponent: sympy.Expr) -> None:
    """Raise ValueError if the exponent, times the largest in ``base``, exceeds `MAX_EXPONENT`."""
    inner = [abs(p.exp) for p in base.atoms(sympy.Pow) if p.exp.is_number]
    if not exponent.is_number or abs(exponent) * max([1, *inner]) > MAX_EXPONENT:
        raise ValueError(f"an exponent is no number, or beyond {MAX_EXPONENT}")
