"""Constants from (E, nu): PK1-linearisation at rest, and the rule for too many or too few.

Chen & Barbic, eq. 3 and 4: to second order at rest every isotropic energy is linear elasticity in
the stretches, with mu_lame and lambda_lame its second derivatives. A material with two free
constants is solved for. With more than two the solution is not unique: of all of them the one that
moves the constants least (least squares) from their defaults is taken, and any may be pinned by the
user. With one, Poisson's ratio is the family's own, and another is refused.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.invariants import SIGMA

_REST = dict.fromkeys(SIGMA, sympy.Integer(1))

Pair = tuple[sympy.Expr, sympy.Expr]


def lame(E: float, nu: float) -> tuple[float, float]:
    """Small-strain constants (mu_lame, lambda_lame) [Pa] of (E [Pa], nu); (E/3, inf) at nu = 0.5.

    Raises BadInput unless E > 0 and -1 < nu <= 0.5.
    """
    if not (math.isfinite(E) and E > 0):
        raise BadInput(f"E = {E}: Young's modulus must be a positive number [Pa]")
    if not -1 < nu <= 0.5:
        raise BadInput(f"nu = {nu}: Poisson's ratio must be more than -1, and 0.5 at most")
    if nu == 0.5:
        return E / 3, math.inf
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


def at_rest(expression: sympy.Expr) -> sympy.Expr:
    """The expression in the stretches at s0 = s1 = s2 = 1."""
    return sympy.sympify(expression).subs(_REST)


def linearised(slopes: Sequence[sympy.Expr]) -> Pair:
    """(mu_lame, lambda_lame) of principal stresses ``slopes`` (eq. 3, 4), in their constants."""
    a, b = (at_rest(sympy.diff(slopes[0], s)) for s in SIGMA[:2])
    return sympy.expand((a - b) / 2), sympy.expand(b)


class Constants:
    """The free constants of a material and what decides them.

    symbols : in the order of the material function's arguments.
    defaults : [units of E] of those that have one.
    pins : [Pa] values the user insists on.
    """

    def __init__(
        self,
        name: str,
        symbols: Sequence[sympy.Symbol],
        defaults: Mapping[sympy.Symbol, float],
        pins: Mapping[sympy.Symbol, float],
    ) -> None:
        self.name, self.symbols = name, tuple(symbols)
        self.defaults, self.pins = dict(defaults), dict(pins)
        self.free = tuple(c for c in symbols if c not in pins)

    def solve(
        self, moduli: Pair, target: tuple[Any, Any], E: float, mixed: bool = False
    ) -> tuple[sympy.Expr, ...]:
        """Values that make ``moduli`` equal to ``target`` (numbers or symbols), in order.

        ``mixed``: another material brings the lambda part, so one constant may do.
        Raises BadInput where there are none, or several and no rule to choose by.
        """
        # Exact rationals of the doubles: the solution is then right to the last digit.
        pinned = {c: sympy.Rational(v) for c, v in self.pins.items()}
        known = [m.subs(pinned) for m in moduli]
        wanted = [t if isinstance(t, sympy.Basic) else sympy.Rational(t) for t in target]
        if len(self.free) == 1:
            found = self._one(known, wanted, mixed or not wanted[1].is_number)
        elif len(self.free) == 2:
            found = self._two(known, wanted)
        else:
            found = self._many(known, wanted, E)
        found = pinned | found
        return tuple(found[c] for c in self.symbols)

    def _two(self, moduli: list[Any], target: list[Any]) -> dict[Any, Any]:
        equations = [m - t for m, t in zip(moduli, target, strict=True)]
        solutions = sympy.solve(equations, self.free, dict=True)
        if len(solutions) != 1 or set(solutions[0]) != set(self.free):
            raise BadInput(
                f"material '{self.name}' cannot be fitted to E and nu: its constants "
                f"{self._names()} have {len(solutions)} solutions"
            )
        return dict(solutions[0])

    def _one(self, moduli: list[Any], target: list[Any], mixed: bool) -> dict[Any, Any]:
        (c,) = self.free
        mu, lam = moduli
        solutions = sympy.solve(mu - target[0], c)
        if len(solutions) != 1:
            raise BadInput(f"material '{self.name}': {c} does not decide its stiffness")
        own = lam.subs(c, solutions[0])
        if not mixed and abs(own - target[1]) > 1e-12 * abs(target[0]):
            nu = float(own / (2 * (own + target[0])))
            what = f"has one free constant, {c}, and so nu = {nu:.6g}"
            raise BadInput(f"material '{self.name}' {what}: give that nu, or a lambda_part")
        return {c: solutions[0]}

    def _many(self, moduli: list[Any], target: list[Any], E: float) -> dict[Any, Any]:
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
            raise BadInput(f"material '{self.name}' cannot be fitted: {self._names()} do not do")
        moved = start + M.T * (M * M.T).inv() * gap
        return dict(zip(self.free, moved, strict=True))

    def _names(self) -> str:
        return ", ".join(map(str, self.free))
