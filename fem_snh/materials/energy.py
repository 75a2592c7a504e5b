"""An energy density as one sympy expression, with its constants fitted to (E, nu)."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.invariants import INVARIANTS, MEASURES, SIGMA

_REST = dict.fromkeys(SIGMA, sympy.Integer(1))


def shape_parameters(function: Callable[..., Any]) -> dict[str, Any]:
    """The keyword-only arguments of a material function with their defaults; ``nu`` is no shape."""
    return {
        name: parameter.default
        for name, parameter in inspect.signature(function).parameters.items()
        if parameter.kind is parameter.KEYWORD_ONLY and name != "nu"
    }


def lame(E: float, nu: float) -> tuple[float, float]:
    """Small-strain constants (mu_lame, lambda_lame) [Pa] of (E [Pa], nu).

    Raises BadInput unless E > 0 and -1 < nu < 0.5.
    """
    if not (math.isfinite(E) and E > 0):
        raise BadInput(f"E = {E}: Young's modulus must be a positive number [Pa]")
    if not -1 < nu < 0.5:
        raise BadInput(f"nu = {nu}: Poisson's ratio must lie between -1 and 0.5, both excluded")
    return E / (2 * (1 + nu)), E * nu / ((1 + nu) * (1 - 2 * nu))


class Energy:
    """One material with its numbers: psi(F) [Pa], zero at rest, normalised to (E, nu).

    Attributes
    ----------
    measures : the invariants (or stretches) psi is written in, as sympy symbols.
    constants : the symbols of the material's own constants, e.g. (mu, lam) ...
    values : ... and their values [Pa], solved from PK1-linearisation at rest.
    psi : the expression in ``measures`` and ``constants``; psi = 0 at F = I.
    psi_sigma : the same in the principal stretches.
    """

    def __init__(
        self, function: Callable[..., Any], E: float, nu: float, shape: Mapping[str, Any]
    ) -> None:
        self.name = function.__name__
        self.E, self.nu, self.shape = float(E), float(nu), dict(shape)
        target = lame(self.E, self.nu)
        positional, keywords = _arguments(function)
        self.measures = tuple(MEASURES[a] for a in positional if a in MEASURES)
        self.constants = tuple(sympy.Symbol(a, real=True) for a in positional if a not in MEASURES)
        given = {k: v for k, v in shape.items() if k in keywords}
        if "nu" in keywords:
            given["nu"] = self.nu
        psi = sympy.sympify(function(*self.measures, *self.constants, **given))
        self.psi = psi - self._in_stretches(psi).subs(_REST)
        self.values = self._normalise(target)

    @property
    def needs_stretches(self) -> bool:
        """Whether the energy itself needs the singular values of F (not only I_C, II_C and J)."""
        return any(str(m) in {"I1", "s0", "s1", "s2"} for m in self.measures)

    @cached_property
    def psi_sigma(self) -> sympy.Expr:
        """The energy as a function of the principal stretches ``s0, s1, s2``."""
        return self._in_stretches(self.psi)

    @cached_property
    def domain(self) -> tuple[sympy.Expr, ...]:
        """Expressions in ``measures`` that must be positive.

        Arguments of log, bases of real powers. Where one is not, the energy is +inf. What is
        positive for every F is left out.
        """
        bases = {a.args[0] for a in self.psi.atoms(sympy.log)}
        bases |= {p.base for p in self.psi.atoms(sympy.Pow) if not p.exp.is_integer}
        return tuple(
            sorted(
                (b for b in bases if b.free_symbols & set(self.measures) and not b.is_positive),
                key=str,
            )
        )

    @property
    def lame(self) -> tuple[float, float]:
        """(mu_lame, lambda_lame) [Pa] from the energy itself, by differentiating it at rest.

        PK1-linearisation (Chen & Barbic eq. 3, 4): in stretch space linear elasticity is
        mu sum (s_i - 1)^2 + lambda/2 (sum s_i - 3)^2.
        """
        numbers = dict(zip(self.constants, self.values, strict=True))
        mu, lam = (float(e.subs(numbers)) for e in self._linearised())
        return mu, lam

    def evaluate(self, module: Any, *measures: Any) -> Any:
        """psi with ``measures`` of any kind: ``module`` maps log, exp, sqrt... (ufl, "mpmath")."""
        call = sympy.lambdify((*self.measures, *self.constants), self.psi, modules=module)
        return call(*measures, *self.values)

    def _in_stretches(self, expression: sympy.Expr) -> sympy.Expr:
        return expression.subs(INVARIANTS)

    def _linearised(self) -> tuple[sympy.Expr, sympy.Expr]:
        """(mu_lame, lambda_lame) as expressions in the constants."""
        s0, s1, _ = SIGMA
        first = sympy.diff(self.psi_sigma, s0)
        a = sympy.diff(first, s0).subs(_REST)
        b = sympy.diff(first, s1).subs(_REST)
        return sympy.simplify((a - b) / 2), sympy.simplify(b)

    def _normalise(self, target: tuple[float, float]) -> tuple[float, ...]:
        """Solve for the constants that give ``target`` = (mu_lame, lambda_lame)."""
        if len(self.constants) != 2:
            raise BadInput(
                f"material '{self.name}' must have two free constants to be fitted to (E, nu); "
                f"it has {', '.join(map(str, self.constants)) or 'none'}"
            )
        # Exact rationals of the doubles: the solution is then right to the last digit.
        equations = [e - sympy.Rational(t) for e, t in zip(self._linearised(), target, strict=True)]
        solutions = sympy.solve(equations, self.constants, dict=True)
        if len(solutions) != 1 or set(solutions[0]) != set(self.constants):
            raise BadInput(
                f"material '{self.name}' with {self.shape} cannot be fitted to E = {self.E}, "
                f"nu = {self.nu}: its constants {', '.join(map(str, self.constants))} "
                f"have {len(solutions)} solutions"
            )
        return tuple(float(solutions[0][c]) for c in self.constants)


def _arguments(function: Callable[..., Any]) -> tuple[list[str], set[str]]:
    parameters = inspect.signature(function).parameters.values()
    positional = [p.name for p in parameters if p.kind is p.POSITIONAL_OR_KEYWORD]
    return positional, {p.name for p in parameters if p.kind is p.KEYWORD_ONLY}
