"""Shape parameters as arguments of the kernels: one library serves all of their values.

E and nu never compile another library, because the material's constants are arguments. A shape
parameter is an argument, too, unless its value selects another function. Compiled in are

- texts, booleans, the default value and 0;
- exponents that are whole numbers or halves: kernels without pow take 0.6 to 0.9 times as long, and
  whole numbers need no positive base; so are exponents with a function of a parameter;
- thresholds that separate pieces of the energy (``c2_neo_hookean``, ``filtered_neo_hookean``,
  ``epsilon``);
- parameters that the material's function compares with numbers in a way that a sign does not
  decide;
- all of them if constants are prescribed.
"""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import Any, NamedTuple

import mpmath
import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.energy import Energy
from fem_snh.materials.functions import INVARIANTS, SIGMA, Parameter, exact, parameters_in, where

#: Stretches at which both forms of an energy are compared, the last ones only if the energy is
#: finite there.
_STRETCHES = ((1.3, 0.9, 0.7), (0.85, 1.05, 1.1), (1.2, 0.04, -0.3))
#: Digits of the comparison, and the accepted difference: functions may contain rounded numbers.
_DIGITS, _SAME = 40, 1e-12


class _Number(NamedTuple):
    """A number among the shape parameters."""

    key: str
    position: int | None
    symbol: sympy.Symbol
    value: float


@lru_cache(maxsize=16)
def with_arguments(energy: Energy) -> Energy:
    """Return an energy with symbols for the shape parameters that its kernels have as arguments.

    Its values are those of ``energy``; without such a parameter it is ``energy`` itself.
    """
    chosen = _numbers(energy)
    if not chosen or energy.fit.pins:
        return energy
    made = _with_symbols(energy, chosen)
    if made is None and len(chosen) > 1:
        chosen = [number for number in chosen if _with_symbols(energy, [number])]
        made = _with_symbols(energy, chosen)
    if made is None:
        return energy
    exponents = [p.exp for p in made.atoms(sympy.Pow) if parameters_in([p.exp])]
    special = [n for n in chosen if any(_is_special(n, e) for e in exponents)]
    if special:
        made = _with_symbols(energy, [n for n in chosen if n not in special])
    return made or energy


def _is_special(number: _Number, exponent: sympy.Expr) -> bool:
    """Return whether a number has to be compiled into an exponent, a scalar of the C code."""
    if not exponent.has(number.symbol):
        return False
    return (2 * number.value).is_integer() or not exponent.is_rational_function()


def _numbers(energy: Energy) -> list[_Number]:
    """Return the numbers that may become arguments."""
    found = []
    for key, value in energy.adjusted.items():
        values = value if isinstance(value, tuple) else (value,)
        for k, number in enumerate(values):
            if isinstance(number, bool) or not isinstance(number, int | float) or number == 0:
                continue
            position = k if isinstance(value, tuple) else None
            name = f"shape_{key}" if position is None else f"shape_{key}_{position}"
            # The sign is known: functions may compare with 0, and powers may be combined.
            symbol = Parameter(name, **{"positive" if number > 0 else "negative": True})
            found.append(_Number(key, position, symbol, float(number)))
    return found


def _with_symbols(energy: Energy, numbers: list[_Number]) -> Energy | None:
    """Return the energy with symbols for some numbers, or None if it is not the same energy."""
    assert energy.with_symbols is not None
    symbols = dict(energy.adjusted)
    for key, position, symbol, _ in numbers:
        if position is None:
            symbols[key] = symbol
        else:
            values = list(symbols[key])
            values[position] = symbol
            symbols[key] = tuple(values)
    try:
        made = energy.with_symbols(symbols)
    except BadInput:  # the function's code needs a number
        return None
    present = parameters_in([made.psi, *made.slopes, *made.barriers])
    used = [n for n in numbers if n.symbol in present]
    if not used:
        return None
    made = replace(
        made,
        parameters=tuple(n.symbol for n in used),
        parameter_values=tuple(n.value for n in used),
    )
    return made if _is_same(made, energy) else None


def _is_same(made: Energy, energy: Energy) -> bool:
    """Return whether energies are equal, in their domains and in what vanishes at rest, too."""
    if len(made.domain) != len(energy.domain):
        return False
    rest = dict.fromkeys(SIGMA, sympy.Integer(1))
    for piecewise in made.atoms(where):
        if not sympy.simplify(piecewise.args[0].subs(INVARIANTS).subs(rest)).is_number:
            return False
    for one, other in zip(_expressions(made), _expressions(energy), strict=True):
        vanishes = [sympy.simplify(e.subs(rest)).is_zero is True for e in (one, other)]
        if vanishes[0] != vanishes[1]:
            return False
    with mpmath.workdps(_DIGITS):
        values = zip(_values(made), _values(energy), strict=True)
        return all(abs(a - b) <= _SAME * (1 + abs(b)) for a, b in values)


def _values(energy: Energy) -> list[Any]:
    """Return psi, a stress and the limits of the domain at `_STRETCHES`, with any constants."""
    arguments = (*SIGMA, *energy.constants, *energy.parameters)
    constants = [mpmath.mpf(k + 2) / 3 for k in range(len(energy.constants))]
    fractions = map(exact, energy.parameter_values)
    parameters = [mpmath.mpf(int(f.p)) / int(f.q) for f in fractions]
    limits = [limit.subs(INVARIANTS) for limit in energy.domain]
    call = sympy.lambdify(arguments, (_expressions(energy), limits), "mpmath")
    found = []
    for s in _STRETCHES if energy.inversion_safe else _STRETCHES[:-1]:
        values, restrictions = call(*map(mpmath.mpf, s), *constants, *parameters)
        found += [*values, *sorted(restrictions, key=lambda x: (mpmath.re(x), mpmath.im(x)))]
    return found


def _expressions(energy: Energy) -> list[sympy.Expr]:
    """Return what defines an energy, in the stretches."""
    psi = [] if energy.psi_sigma is None else [energy.psi_sigma]
    return [*psi, energy.slopes[0]]
