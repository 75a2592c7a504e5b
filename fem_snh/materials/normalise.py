"""Fit the constants of an energy to (E, nu) by PK1-linearisation at rest.

To second order at rest every isotropic energy is linear elasticity in the stretches; its second
derivatives give mu_lame and lambda_lame (Chen & Barbic, eq. 3, 4). The number of free constants
decides how these two equations are solved:

two
    The two equations are solved.
more than two
    The solution nearest to the defaults, in the least-squares sense. The user may pin (prescribe)
    any of the constants.
one
    The equation for mu_lame is solved. Poisson's ratio is then a property of the energy, and any
    other value of nu is an error.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Any

import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.invariants import SIGMA
from fem_snh.materials.parameters import check_constants

_REST = dict.fromkeys(SIGMA, sympy.Integer(1))

Pair = tuple[sympy.Expr, sympy.Expr]
Moduli = list[sympy.Expr]
Values = dict[sympy.Symbol, sympy.Expr]

#: Accepted difference, relative to mu_lame, between the requested lambda_lame and the lambda_lame
#: of an energy with one constant: the rounding error of nu.
_LAMBDA_TOLERANCE = 1e-12
#: Accepted relative difference between the shear moduli that prescribed constants give and that E
#: and nu give: the rounding error of the ten digits that the error message shows.
_PINNED_TOLERANCE = 1e-9
#: Digits of irrational numbers in the equations for the constants, far more than a double has.
_DIGITS = 50


def lame(E: float, nu: float) -> tuple[float, float]:
    """Return the small-strain constants (mu_lame, lambda_lame) [Pa].

    Parameters
    ----------
    E : float
        Young's modulus [Pa].
    nu : float
        Poisson's ratio; at 0.5 the constants are (E/3, inf).

    Raises
    ------
    BadInput
        Unless E is in [1e-100, 1e100] and nu in (-1, 0.5].
    """
    E, nu = check_constants(E, nu)
    if nu == 0.5:
        return E / 3, math.inf
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def at_rest(expression: sympy.Expr) -> sympy.Expr:
    """Return the value of an expression in the stretches at s0 = s1 = s2 = 1."""
    return sympy.sympify(expression).subs(_REST)


def linearised(slopes: Sequence[sympy.Expr]) -> Pair:
    """Return (mu_lame, lambda_lame), in the constants, of the three principal stresses ``slopes``.

    References
    ----------
    Chen & Barbic, eq. 3, 4.
    """
    a, b = (at_rest(sympy.diff(slopes[0], s)) for s in SIGMA[:2])
    return sympy.expand((a - b) / 2), sympy.expand(b)


def solve(*args: Any, **settings: Any) -> list[Any]:
    """Return the solutions of ``sympy.solve``; [] if it finds none."""
    try:
        return list(sympy.solve(*args, **settings))
    except NotImplementedError:
        return []


class Normalisation:
    """The constants of a material and the equations that determine the free ones.

    Parameters
    ----------
    name : str
        The material, for messages.
    symbols : sequence of sympy.Symbol
        All constants, in the order of the material function's arguments.
    defaults : mapping
        Default values [units of E] of the constants that have a default.
    pins : mapping
        Values [Pa] of the constants that the user prescribes. The other constants are free.
    moduli : pair of sympy.Expr
        (mu_lame, lambda_lame) in the constants, from `linearised`.
    """

    def __init__(
        self,
        name: str,
        symbols: Sequence[sympy.Symbol],
        defaults: Mapping[sympy.Symbol, float],
        pins: Mapping[sympy.Symbol, float],
        moduli: Pair,
    ) -> None:
        self.name, self.symbols = name, tuple(symbols)
        self.defaults, self.pins = dict(defaults), dict(pins)
        self.free = tuple(c for c in symbols if c not in pins)
        self.moduli = moduli

    def solve(
        self, target: tuple[float | sympy.Expr, float | sympy.Expr], E: float, mixed: bool = False
    ) -> tuple[sympy.Expr, ...]:
        """Return the constants, in the order of ``symbols``, whose moduli equal ``target``.

        Parameters
        ----------
        target : pair
            (mu_lame, lambda_lame), as numbers [Pa] or symbols.
        E : float
            Young's modulus, the unit of the defaults [Pa].
        mixed : bool
            True if another material supplies the lambda part: lambda_lame of a material with one
            constant is then not checked.

        Raises
        ------
        BadInput
            If there is no solution, or more than one and no default to choose by.
        """
        pins, free = self.pins, self.free
        if pins and isinstance(target[0], sympy.Symbol):
            # Solve for the pinned constants that E and nu determine, so that the symbols enter.
            released = determined(
                (_rational(self.moduli[0]), _rational(self.moduli[1])), list(pins)
            )
            pins = {c: v for c, v in pins.items() if c not in released}
            free = tuple(c for c in self.symbols if c not in pins)
        # The doubles as exact rationals: the solution is then accurate to double precision.
        pinned = {c: sympy.Rational(v) for c, v in pins.items()}
        known = [_rational(m.subs(pinned)) for m in self.moduli]
        wanted = [t if isinstance(t, sympy.Basic) else sympy.Rational(t) for t in target]
        if pins and known[0].is_number:
            found = self._solve_without_shear(known, wanted)
        elif len(free) == 1:
            found = self._solve_one(known, wanted, mixed or not wanted[1].is_number)
        elif len(free) == 2:
            found = self._solve_two(known, wanted, free)
        else:
            found = self._nearest_to_defaults(known, wanted, E)
        found = pinned | found
        return tuple(found[c] for c in self.symbols)

    def _solve_two(self, moduli: Moduli, target: Moduli, free: tuple[sympy.Symbol, ...]) -> Values:
        """Return the two free constants that solve both equations; BadInput unless unique."""
        equations = [m - t for m, t in zip(moduli, target, strict=True)]
        solutions = solve(equations, free, dict=True)
        if len(solutions) != 1 or set(solutions[0]) != set(free):
            raise BadInput(
                f"material '{self.name}' cannot be fitted to E and nu: its constants "
                f"{', '.join(map(str, free))} have {len(solutions)} solutions"
            )
        return dict(solutions[0])

    def _solve_without_shear(self, moduli: Moduli, target: Moduli) -> Values:
        """Return the one free constant if the prescribed constants determine the shear modulus.

        Raises
        ------
        BadInput
            If E and nu give another shear modulus, or unless exactly one constant is free and
            lambda_lame depends on it.
        """
        given = ", ".join(f"{c} = {float(v):g}" for c, v in self.pins.items())
        what = f"material '{self.name}' with {given}"
        shear = [c for c in self.symbols if c in self.moduli[0].free_symbols]
        cure = f"{' or '.join(map(str, shear))} without a value"
        wanted = target[0]
        if abs(moduli[0] - wanted) > _PINNED_TOLERANCE * abs(wanted):
            raise BadInput(
                f"{what} has the shear modulus {float(moduli[0]):.10g} Pa, E and nu have "
                f"{float(wanted):.10g} Pa: expected {self.moduli[0]} = {float(wanted):.10g}, or "
                f"{cure}"
            )
        if len(self.free) != 1 or not moduli[1].has(*self.free):
            raise BadInput(
                f"{what} has no free constant, to be fitted to E and nu: expected {cure}"
            )
        (c,) = self.free
        (value,) = sympy.solve(moduli[1] - target[1], c)
        return {c: value}

    def _solve_one(self, moduli: Moduli, target: Moduli, mixed: bool) -> Values:
        """Return the one free constant from mu_lame; unless ``mixed``, check lambda_lame too."""
        (c,) = self.free
        mu, lam = moduli
        solutions = solve(mu - target[0], c)
        if len(solutions) != 1:
            raise BadInput(
                f"material '{self.name}' cannot be fitted to E and nu: its shear modulus "
                f"{mu} does not determine {c}"
            )
        own = lam.subs(c, solutions[0])
        if not mixed and abs(own - target[1]) > _LAMBDA_TOLERANCE * abs(target[0]):
            nu = float(own / (2 * (own + target[0])))
            what = f"has one free constant, {c}, and so nu = {nu:.6g}"
            raise BadInput(f"material '{self.name}' {what}: give that nu, or a lambda_part")
        return {c: solutions[0]}

    def _nearest_to_defaults(self, moduli: Moduli, target: Moduli, E: float) -> Values:
        """Return the constants that solve both equations and are nearest to their defaults."""
        lost = [str(c) for c in self.free if c not in self.defaults]
        if not self.free or lost:
            have = f"the free constants {self._names()}" if self.free else "no free constant"
            cure = f": pin {', '.join(lost)} or give defaults [E]" if lost else ""
            raise BadInput(f"material '{self.name}' has {have}, to be fitted to E and nu{cure}")
        try:
            M, offset = sympy.linear_eq_to_matrix(moduli, *self.free)
        except sympy.solvers.solveset.NonlinearError:
            raise BadInput(
                f"material '{self.name}': its stiffness is not linear in its free constants "
                f"{self._names()}: pin all but two of them"
            ) from None
        start = sympy.Matrix([sympy.Rational(self.defaults[c]) * E for c in self.free])
        gap = sympy.Matrix(target) + offset - M * start
        if (M * M.T).det() == 0:
            raise BadInput(
                f"material '{self.name}' cannot be fitted to E and nu: its stiffness does not "
                f"depend on {self._names()} in two independent ways"
            )
        moved = start + M.T * (M * M.T).inv() * gap
        return dict(zip(self.free, moved, strict=True))

    def _names(self) -> str:
        return ", ".join(map(str, self.free))


def determined(moduli: Pair, pinned: Sequence[sympy.Symbol]) -> frozenset[sympy.Symbol]:
    """Return the fewest pinned constants to release so that every E and nu can be matched.

    Parameters
    ----------
    moduli : pair of sympy.Expr
        (mu_lame, lambda_lame) in the constants.
    pinned : sequence of sympy.Symbol
        The constants that are prescribed; all are returned if no choice suffices.
    """
    free = [c for c in moduli[0].free_symbols | moduli[1].free_symbols if c not in pinned]
    for size in range(len(pinned) + 1):
        for chosen in combinations(pinned, size):
            columns = [*chosen, *free]
            matrix = sympy.Matrix([[sympy.diff(m, c) for c in columns] for m in moduli])
            if matrix.rank() == 2:
                return frozenset(chosen)
    return frozenset(pinned)


def _rational(expression: sympy.Expr) -> sympy.Expr:
    """Return the expression with fractions close to its irrational numbers, such as 3^1.37.

    sympy solves equations with algebraic numbers in an extension field whose degree is the
    denominator of the exponent, which takes hours.
    """
    if expression.is_number:
        return expression if expression.is_Rational else _fraction(expression)
    if not expression.args:
        return expression
    return expression.func(*map(_rational, expression.args))


def _fraction(number: sympy.Expr) -> sympy.Expr:
    """Return a number as a fraction of `_DIGITS` digits; infinite and complex numbers unchanged."""
    value = number.evalf(_DIGITS, chop=True)
    return sympy.Rational(str(value)) if value.is_Float or value.is_Rational else number
