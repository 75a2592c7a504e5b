"""An energy density as one sympy expression, with its constants fitted to (E, nu)."""

from __future__ import annotations

import copy
import inspect
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import sympy

from fem_snh.materials import normalise, tuning
from fem_snh.materials.functions import PrincipalStress, domain, positive
from fem_snh.materials.invariants import INVARIANTS, MEASURES, SIGMA
from fem_snh.materials.signature import constants_of

_LAME = sympy.symbols("mu_lame lambda_lame", real=True)


class Energy:
    """One material with its numbers: psi(F) [Pa], zero at rest, normalised to (E, nu).

    Attributes
    ----------
    measures : the invariants (or stretches) psi is written in, as sympy symbols.
    constants : the symbols of the material's own constants, e.g. (mu, lam) ...
    values : ... and their values [Pa], solved from PK1-linearisation at rest.
    psi : the expression in ``measures`` and ``constants``; psi = 0 at F = I. None for a material
        that has stresses and no energy.
    psi_sigma : the same in the principal stretches.
    slopes : the principal stresses dpsi/ds_i, in the stretches.
    domain : expressions in ``measures`` that must be positive, else the energy is +inf.
    pressure : a symbol that psi has besides, see `fem_snh.materials.volume_split`; usually None.
    """

    pressure: sympy.Symbol | None = None

    def __init__(
        self,
        function: Callable[..., Any],
        E: float,
        nu: float,
        shape: Mapping[str, Any],
        pins: Mapping[str, float] | None = None,
        tuned: Mapping[str, Any] | None = None,
        lambda_part: Energy | None = None,
    ) -> None:
        self.name = function.__name__
        self.E, self.nu = float(E), float(nu)
        target = normalise.lame(self.E, self.nu)
        given = {k: v for k, v in (tuned or {}).items() if v is not None}
        self.shape = dict(shape) | given
        self._write(function, shape)
        self._fit(function, pins or {}, target, mixed=lambda_part is not None)
        if given:
            self._tune(tuning.check(given), lambda_part, target)

    # --- what it is ------------------------------------------------------------------------------

    @property
    def has_energy(self) -> bool:
        """Whether the stress is the gradient of an energy."""
        return self.psi is not None

    @property
    def incompressible(self) -> bool:
        """Whether nu = 0.5: only mixed elements know what to do with it."""
        return self.nu == 0.5

    @property
    def of_stretches(self) -> bool:
        """Whether it is written in the principal stretches themselves."""
        return bool(set(self.measures) & set(SIGMA))

    @property
    def needs_stretches(self) -> bool:
        """Whether the energy itself needs the singular values of F (not only I_C, II_C and J)."""
        return any(str(m) in {"I1", "s0", "s1", "s2"} for m in self.measures)

    @property
    def inversion_safe(self) -> bool:
        """Whether it is finite for every F."""
        return not self.domain

    @cached_property
    def domain(self) -> tuple[sympy.Expr, ...]:
        """What must be positive: arguments of log, bases of real powers, and of `positive`.

        What is positive for every F is left out, and so are the pieces of a `where`.
        """
        expressions = [self.psi] if self.psi is not None else self.slopes
        return domain(expressions, self.measures, self._barriers)

    @cached_property
    def psi_sigma(self) -> sympy.Expr:
        """The energy as a function of the principal stretches ``s0, s1, s2``."""
        return None if self.psi is None else self.psi.subs(INVARIANTS)

    @cached_property
    def slopes(self) -> tuple[sympy.Expr, ...]:
        """Principal PK1 stresses dpsi/ds_i [Pa] in the stretches and constants."""
        if self._stress is not None:
            return self._stress
        return tuple(sympy.diff(self.psi_sigma, s) for s in SIGMA)

    @cached_property
    def lame(self) -> tuple[float, float]:
        """(mu_lame, lambda_lame) [Pa] from the energy itself, by differentiating it at rest.

        lambda_lame is infinite at nu = 0.5.

        PK1-linearisation (Chen & Barbic eq. 3, 4): in stretch space linear elasticity is
        mu sum (s_i - 1)^2 + lambda/2 (sum s_i - 3)^2.
        """
        if self.incompressible:
            return normalise.lame(self.E, self.nu)
        mu, lam = (float(e.subs(self._numbers)) for e in normalise.linearised(self.slopes))
        return mu, lam

    @cached_property
    def rest_stress(self) -> float:
        """The principal PK1 stress at F = I [Pa]: 0 for a material that stays at rest."""
        stress = sympy.simplify(normalise.at_rest(self.slopes[0]))
        return float(stress.subs(self._numbers))

    def evaluate(self, module: Any, *measures: Any) -> Any:
        """psi with ``measures`` of any kind: ``module`` maps log, exp, where... (ufl, "mpmath")."""
        call = sympy.lambdify((*self.measures, *self.constants), self.psi, modules=module)
        return call(*measures, *self.values)

    @property
    def lambda_symbol(self) -> sympy.Symbol:
        """What `by_lame` calls lambda_lame."""
        return _LAME[1]

    def by_lame(self) -> sympy.Expr:
        """psi in its measures, its constants written in the symbols mu_lame and lambda_lame."""
        if self.constants == _LAME:
            return self.psi
        solution = self._constants.solve(self._moduli, _LAME, self.E)
        return self.psi.subs(dict(zip(self.constants, solution, strict=True)), simultaneous=True)

    def at_pressure(
        self, psi: sympy.Expr, pressure: sympy.Symbol, constants: Mapping[sympy.Symbol, float]
    ) -> Energy:
        """The energy psi + pressure J; psi is in the symbols of `by_lame` and more constants."""
        other = copy.copy(self)
        J = MEASURES["J"]
        other.constants = (*_LAME, *constants)
        other.values = (*normalise.lame(self.E, self.nu), *constants.values())
        other.pressure = pressure
        if not self.of_stretches:
            other.measures = tuple(dict.fromkeys((*self.measures, J)))
        other.psi = psi + pressure * (J.subs(INVARIANTS) if self.of_stretches else J)
        other._forget()
        return other

    # --- how it is made --------------------------------------------------------------------------

    @property
    def _numbers(self) -> dict[sympy.Symbol, float]:
        return dict(zip(self.constants, map(sympy.Float, self.values), strict=True))

    def _write(self, function: Callable[..., Any], shape: Mapping[str, Any]) -> None:
        """The expression, from the material's function."""
        parameters = inspect.signature(function).parameters
        named = [n for n, p in parameters.items() if p.kind is p.POSITIONAL_OR_KEYWORD]
        self.measures = tuple(MEASURES[n] for n in named if n in MEASURES)
        self.constants = tuple(sympy.Symbol(n, real=True) for n in constants_of(function))
        extra = {"nu": self.nu} if "nu" in parameters else {}
        found = function(*self.measures, *self.constants, **shape, **extra)
        self._barriers: set[sympy.Expr] = set()
        self.psi: Any = None
        self._stress: tuple[sympy.Expr, ...] | None = None
        if isinstance(found, PrincipalStress):
            self._stress = tuple(self._open(p) for p in found)
        else:
            psi = self._open(found)
            self.psi = psi - normalise.at_rest(psi.subs(INVARIANTS))

    def _open(self, expression: Any) -> sympy.Expr:
        """The expression without its `positive`, which become barriers of the domain."""
        expression = sympy.sympify(expression)
        found = expression.atoms(positive)
        self._barriers |= {p.args[0] for p in found}
        return expression.xreplace({p: p.args[0] for p in found})

    def _fit(
        self,
        function: Callable[..., Any],
        pins: Mapping[str, float],
        target: tuple[float, float],
        mixed: bool,
    ) -> None:
        """Solve for the constants; ``mixed``: only the mu part will be used."""
        defaults = constants_of(function)
        known = {str(c): c for c in self.constants}
        self._constants = normalise.Constants(
            self.name,
            self.constants,
            {known[k]: v for k, v in defaults.items() if v is not None},
            {known[k]: v for k, v in pins.items()},
        )
        self._moduli = normalise.linearised(self.slopes)
        if self.incompressible:
            solution = self._constants.solve(self._moduli, (target[0], _LAME[1]), self.E, mixed)
            solution = tuple(sympy.limit(v, _LAME[1], sympy.oo) for v in solution)
        else:
            solution = self._constants.solve(self._moduli, target, self.E, mixed)
        self.values = tuple(float(v) for v in solution)

    def _tune(
        self, given: Mapping[str, Any], other: Energy | None, target: tuple[float, float]
    ) -> None:
        """Nonlinearity and mixing: from here on the energy is one of the stretches."""
        alphas = given["alpha_mu"], given["alpha_lambda"]
        if other is None and alphas == (1, 1):
            return
        if other is None and alphas[0] == alphas[1]:
            psi, stress = self._nonlinear(self.psi_sigma, self.slopes, alphas[0], given, [self])
        else:
            mu, lam = _LAME
            mine, theirs = (e._parts(mu, lam) for e in (self, other or self))
            sources = [self, other or self]
            (psi_mu, slopes_mu), (psi_lam, slopes_lam) = mine[0], theirs[1]
            a = self._nonlinear(psi_mu, slopes_mu, alphas[0], given, sources)
            b = self._nonlinear(psi_lam, slopes_lam, alphas[1], given, sources)
            psi = None if None in (a[0], b[0]) else mu * a[0] + lam * b[0]
            stress = tuple(mu * p + lam * q for p, q in zip(a[1], b[1], strict=True))
            self.constants, self.values = _LAME, target
        barriers = self.domain if other is None else (*self.domain, *other.domain)
        self.measures, self.psi = SIGMA, psi
        self._stress = None if psi is not None else stress
        self._barriers = {b.subs(INVARIANTS) for b in barriers}
        self._forget()

    def _forget(self) -> None:
        """The expression has changed: what was derived from it is derived anew."""
        for name in ("domain", "psi_sigma", "slopes", "lame", "rest_stress"):
            self.__dict__.pop(name, None)

    def _nonlinear(
        self, psi: Any, slopes: Any, alpha: float, given: Mapping[str, Any], of: list[Energy]
    ) -> Any:
        epsilon = given["epsilon"]
        if epsilon is None:
            epsilon = tuning.EPSILON if all(e.inversion_safe for e in of) else 0
        return tuning.nonlinear(psi, slopes, alpha, epsilon)

    def _parts(self, mu: sympy.Symbol, lam: sympy.Symbol) -> Any:
        """((psi, slopes) of the mu part, (psi, slopes) of the lambda part), each of unit size."""
        solution = self._constants.solve(self._moduli, (mu, lam), self.E)
        numbers = dict(zip(self.constants, solution, strict=True))
        if self.psi is None:
            pairs = tuning.parts(self.name, [p.subs(numbers) for p in self.slopes], mu, lam)
            return tuple((None, slopes) for slopes in zip(*pairs, strict=True))
        ((own, other),) = tuning.parts(self.name, [self.psi_sigma.subs(numbers)], mu, lam)
        return tuple((p, tuple(sympy.diff(p, s) for s in SIGMA)) for p in (own, other))
