"""Construct an `Energy` from a material's function: evaluate it, fit its constants, tune it.

`fem_snh.materials.making` calls `construct` once for each material.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any, NamedTuple

import sympy
from sympy.codegen.cfunctions import log1p

from fem_snh.errors import BadInput, shown
from fem_snh.materials import normalise, tuning
from fem_snh.materials.energy import LAME, Energy, principal_stresses
from fem_snh.materials.invariants import (
    INVARIANTS,
    MEASURES,
    PrincipalStress,
    parameters_in,
    positive,
    where,
)
from fem_snh.materials.parameters import (
    MAX_EXPONENT,
    Function,
    Keywords,
    check,
    check_constants,
    constants_of,
    measures_of,
)

#: Functions that the generated C and the UFL forms can evaluate.
_FUNCTIONS = (sympy.log, log1p, sympy.exp, where, positive)


def construct(
    function: Function,
    name: str,
    E: float,
    nu: float,
    shape: Keywords,
    pins: Mapping[str, float],
    tuned: Keywords,
    lambda_part: Energy | None = None,
) -> Energy:
    """Return the energy that ``function`` defines, normalised to (E, nu).

    Parameters
    ----------
    function : callable
        A material function (see `fem_snh.materials`).
    name : str
        The material, for messages and records.
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio.
    shape : mapping
        Values of all shape parameters of the function.
    pins : mapping
        Prescribed values [Pa] of constants of the function.
    tuned : mapping
        Keywords of `fem_snh.materials.TUNING`; None means the default.
    lambda_part : Energy, optional
        The energy that supplies the lambda part.

    Raises
    ------
    BadInput
        If the function does not return an energy, or if the energy cannot be fitted or tuned.
    """
    E, nu = check_constants(E, nu)
    preferred = {c: v for c, v in constants_of(function).items() if v is not None}
    given = {k: v for k, v in tuned.items() if v is not None}

    form = symbolic(function, name, nu, shape)
    known = {str(c): c for c in form.constants}
    defaults, fixed = ({known[k]: v for k, v in of.items()} for of in (preferred, pins))
    fit = normalise.Normalisation(name, form.constants, defaults, fixed, form.moduli)
    values = _fitted(fit, E, nu, mixed=lambda_part is not None)
    whole = dict(shape) | given
    energy = Energy(name=name, E=E, nu=nu, shape=whole, values=values, fit=fit, **form._asdict())
    if given:
        energy = tuning.tune(energy, check(given), lambda_part)
        for term in energy.expressions:
            _check_exponents(term, name)
    return energy


class _Form(NamedTuple):
    """The expressions that a material's function returns, before its constants have values."""

    measures: tuple[sympy.Symbol, ...]
    constants: tuple[sympy.Symbol, ...]
    psi: sympy.Expr | None
    stress: tuple[sympy.Expr, ...] | None
    barriers: frozenset[sympy.Expr]

    @property
    def slopes(self) -> tuple[sympy.Expr, ...]:
        """Return the three principal PK1 stresses in the stretches and the constants."""
        return principal_stresses(self.psi) if self.stress is None else self.stress

    @property
    def moduli(self) -> normalise.Pair:
        """Return (mu_lame, lambda_lame) in the constants."""
        return normalise.linearised(self.slopes)


def symbolic(function: Function, name: str, nu: float | None, shape: Keywords) -> _Form:
    """Call a material's function; return its expressions with psi shifted to psi(I) = 0."""
    measures = tuple(MEASURES[n] for n in measures_of(function))
    constants = tuple(sympy.Symbol(n, real=True) for n in constants_of(function))
    keywords = dict(shape)
    if "nu" in inspect.signature(function).parameters:
        keywords["nu"] = nu
    found = _evaluate(function, name, (*measures, *constants), keywords)
    barriers: set[sympy.Expr] = set()
    if isinstance(found, PrincipalStress):
        stress = tuple(_without_barriers(p, barriers) for p in found)
        return _Form(measures, constants, None, stress, frozenset(barriers))
    psi = _without_barriers(found, barriers)
    psi = psi - normalise.at_rest(psi.subs(INVARIANTS))
    return _Form(measures, constants, psi, None, frozenset(barriers))


def _fitted(fit: normalise.Normalisation, E: float, nu: float, mixed: bool) -> tuple[float, ...]:
    """Return the values [Pa] of the constants, at nu = 0.5 their limits for lambda -> inf."""
    mu, lam = normalise.lame(E, nu)
    if nu == 0.5:
        solution = fit.solve((mu, LAME[1]), E, mixed)
        solution = tuple(sympy.limit(v, LAME[1], sympy.oo) for v in solution)
    else:
        solution = fit.solve((mu, lam), E, mixed)
    return tuple(float(v) for v in solution)


def _evaluate(
    function: Function, name: str, arguments: tuple[sympy.Symbol, ...], keywords: dict[str, Any]
) -> Any:
    """Call a material function; return its value if that is an expression in its measures.

    Raises BadInput otherwise, also for an exception inside the function.
    """
    try:
        found = function(*arguments, **keywords)
    except BadInput:
        raise
    except Exception as error:
        hint = "" if isinstance(error, NameError) else _HINT
        raise BadInput(
            f"material '{name}': its function fails: {type(error).__name__}: {error}{hint}"
        ) from None
    terms = list(found) if isinstance(found, PrincipalStress) else [found]
    measures = set(arguments) & set(MEASURES.values())
    for term in terms:
        returns = f"material '{name}': its function returns {shown(term)}: "
        if isinstance(term, sympy.Expr) and term.has(*_NOT_REAL):
            what = "an expression that is real and finite for its shape parameters"
            raise BadInput(f"{returns}expected {what}")
        if not isinstance(term, sympy.Expr) or not term.free_symbols & measures:
            wanted = ", ".join(str(a) for a in arguments if a in measures)
            raise BadInput(f"{returns}expected a sympy expression in {wanted}")
        if unknown := term.free_symbols - set(arguments) - parameters_in(keywords.values()):
            raise BadInput(
                f"material '{name}': unknown symbol {min(map(str, unknown))}: expected an "
                "expression in the function's arguments"
            )
        _check_functions(term, name)
    return found


#: Results of a division by zero or of the logarithm of a negative number in an expression.
_NOT_REAL = (sympy.zoo, sympy.nan, sympy.oo, -sympy.oo, sympy.I)
#: The most frequent cause of an exception: numpy's and math's functions refuse symbols.
_HINT = (
    "; expected sympy's functions (from sympy import log, exp, sqrt), not those of math or numpy"
)


def _check_functions(term: sympy.Expr, name: str) -> None:
    """Raise BadInput for a function that has no generated code."""
    for call in sorted(term.atoms(sympy.Function), key=str):
        if not isinstance(call, _FUNCTIONS):
            raise BadInput(
                f"material '{name}': function {call.func.__name__}: expected + - * / **, log, exp, "
                "sqrt, where, positive (fem_snh.materials)"
            )
    _check_exponents(term, name)


def _check_exponents(term: sympy.Expr, name: str) -> None:
    """Raise BadInput for a power whose exponent is no number, or too large for generated code.

    Exponents that contain the symbol of a shape parameter are not checked.
    """
    for power in term.atoms(sympy.Pow):
        if parameters_in([power.exp]):
            continue
        if not power.exp.is_number:
            raise BadInput(f"material '{name}': exponent {power.exp} in {power}: expected a number")
        if abs(power.exp) > MAX_EXPONENT:
            raise BadInput(
                f"material '{name}': exponent {float(power.exp):g}: expected a number from "
                f"{-MAX_EXPONENT} to {MAX_EXPONENT}"
            )


def _without_barriers(expression: sympy.Expr, barriers: set[sympy.Expr]) -> sympy.Expr:
    """Return the expression without `positive`, whose arguments are added to ``barriers``."""
    expression = sympy.sympify(expression)

    def plain(x: sympy.Expr) -> sympy.Expr:
        return x.replace(positive, lambda inside: inside)

    barriers |= {plain(p.args[0]) for p in expression.atoms(positive)}
    return plain(expression)
