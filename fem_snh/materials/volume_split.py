r"""Split an energy into a deviatoric part and a volume term, for mixed elements: psi = psi' + U(J).

psi' is psi with a smaller constant lambda_local in place of lambda, and U is the difference. U must
be a function of J alone; for the stable Neo-Hookean energy U = (lambda - lambda_local)/2 (J - 1)^2:

.. math::

    \lambda_\text{local} = \frac{b \mu \lambda}{\lambda + b \mu}

A pressure p, positive in tension, replaces U. The energy at a point is then psi' + p J, and its
Hessian is filtered like the Hessian of any other energy.

psi' resists variations of J within a cell, on which neither the mean of J nor a continuous pressure
acts: with b = 0, parts of twisted Taylor-Hood cells collapse (docs/results/elements.md). For
nu -> 0.5, the Poisson's ratio of psi' tends to 0.4 with b = 4 and to 1/3 with b = 2, where no
element locks.

Mean dilatation
    p = U'(J_e), where J_e is the mean of J over an element.
Taylor-Hood
    p is an unknown. psi' + p J - U*(p), with the conjugate U*(p) = max_J (p J - U(J)), is
    stationary in p where J = dU*/dp, the volume ratio that belongs to p.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.energy import LAME, Energy
from fem_snh.materials.invariants import MEASURES, SIGMA
from fem_snh.materials.normalise import solve

PRESSURE, LOCAL = sympy.symbols("pressure lambda_local", real=True)
J = MEASURES["J"]

#: Newton iterations that compute log J from a pressure to rounding, for J from 0.1 to e.
_NEWTON = 5

_Curve = tuple[sympy.Expr, sympy.Expr, sympy.Expr]


@dataclass(frozen=True)
class Split:
    """An energy split into psi' + p J and the volume term U(J).

    Attributes
    ----------
    energy : Energy
        psi' + pressure J, with the constants mu_lame, lambda_lame and lambda_local.
    volume : sympy.Expr
        U(J) [Pa] in J and the constants; at nu = 0.5 the constraint J = 1 replaces it.
    """

    energy: Energy
    volume: sympy.Expr

    @property
    def deviatoric(self) -> Energy:
        """Return the energy psi', without the term p J."""
        assert self.energy.psi is not None
        return replace(self.energy, psi=self.energy.psi.subs(PRESSURE, 0), pressure=None)

    @property
    def stiffness(self) -> float:
        """Return U''(1) = lambda_lame - lambda_local [Pa]; infinite at nu = 0.5."""
        return self.energy.values[1] - self.local

    @property
    def local(self) -> float:
        """Return lambda_local [Pa]."""
        return self.energy.values[2]

    @property
    def volume_curve(self) -> _Curve:
        """Return (U, U', U'') in J; raise BadInput at nu = 0.5."""
        if math.isinf(self.stiffness):
            raise BadInput(
                f"nu = 0.5: material '{self.energy.name}' is incompressible and requires "
                "a Taylor-Hood element (P2P1, Q2Q1)"
            )
        first = sympy.factor(sympy.diff(self.volume, J))
        return self.volume, first, sympy.diff(first, J)

    @property
    def dual_curve(self) -> _Curve:
        """Return (U*, J(p) = dU*/dp, dJ/dp) in PRESSURE; (p, 1, 0) at nu = 0.5.

        Raises BadInput unless nu > 0, and if sympy cannot solve U'(J) = p for J.
        """
        if math.isinf(self.stiffness):
            return PRESSURE, sympy.Integer(1), sympy.Integer(0)
        if not self.stiffness > 0:
            raise BadInput(
                f"nu = {self.energy.nu:g}: Taylor-Hood elements need a volume that resists, nu > 0"
            )
        if (modulus := self._of_logarithm) is not None:
            return _dual_of_logarithm(modulus)
        found = _inverses(self.volume)
        # Of several branches of the inverse, the one through the rest state.
        numbers = dict(zip(self.energy.constants, self.energy.values, strict=True)) | {
            PRESSURE: 0.0
        }
        at_rest = [g for g in found if (v := g.subs(numbers)).is_finite and abs(v - 1) < 1e-9]
        if len(at_rest) != 1 or at_rest[0].has(sympy.LambertW):
            raise self._without_inverse()
        return _conjugate(self.volume, at_rest[0])

    def check_closed_form(self) -> None:
        """Raise BadInput for U = c/2 (log J)^2: Newton iterations solve its U'(J) = p."""
        if self._of_logarithm is not None:
            raise self._without_inverse()

    def _without_inverse(self) -> BadInput:
        return BadInput(
            f"material '{self.energy.name}': the pressure of its volume term {self.volume} "
            "cannot be inverted in closed form, which unknown pressures need (Taylor-Hood; "
            "static_condensation = false): take Q1P0 or P2P0 with condensed pressures, or a "
            "material with another volume term"
        )

    @property
    def _of_logarithm(self) -> sympy.Expr | None:
        """Return c if U = c/2 (log J)^2, otherwise None."""
        modulus = 2 * self.volume / sympy.log(J) ** 2
        return None if modulus.has(J) else modulus


# The volume terms of most materials are the same expression, whatever E and nu are.
@lru_cache(maxsize=64)
def _inverses(volume: sympy.Expr) -> tuple[sympy.Expr, ...]:
    """Return the solutions J of U'(J) = p, () if sympy finds none."""
    return tuple(solve(sympy.Eq(sympy.diff(volume, J), PRESSURE), J))


@lru_cache(maxsize=64)
def _conjugate(volume: sympy.Expr, inverse: sympy.Expr) -> _Curve:
    """Return (U*, J(p), dJ/dp) of a volume term U(J) and the solution J of U'(J) = p."""
    ratio = sympy.simplify(inverse)
    conjugate = PRESSURE * ratio - volume.subs(J, ratio)
    return sympy.simplify(conjugate), ratio, sympy.simplify(sympy.diff(ratio, PRESSURE))


def _dual_of_logarithm(c: sympy.Expr) -> _Curve:
    r"""Return (U*, J(p), dJ/dp) of U = c/2 (log J)^2.

    With :math:`w = -\log J`, U'(J) = p is :math:`w e^w = -p/c`, which Newton's method solves. The
    first guess is a rational function of :math:`s = \sqrt{2 (1 - e p/c)}` that matches w to third
    order in s at the largest pressure, p = c/e, where J = e (Corless et al. 1996, eq. 4.22). U is
    not convex for J > e.
    """
    z = -PRESSURE / c
    s = sympy.sqrt(2 * (1 + math.e * z))
    w = s * (1 + s / 8) / (1 + 11 * s / 24) - 1
    for _ in range(_NEWTON):
        w = (w**2 + z * sympy.exp(-w)) / (1 + w)
    volume = sympy.exp(-w)
    return -c * w * (1 + w / 2), volume, volume**2 / (c * (1 + w))


def split(energy: Energy, bound: float) -> Split:
    """Split an energy into psi' and its volume term.

    Parameters
    ----------
    energy : Energy
        The energy psi.
    bound : float
        The b of lambda_local. With b = 0, psi' has lambda = 0 (classical mean dilatation).

    Raises
    ------
    BadInput
        If the material has no energy, or if psi - psi' is zero or not a function of J alone.
    """
    if energy.psi is None:
        raise BadInput(f"material '{energy.name}' has no energy: take Q1, Q2, P1 or P2")
    psi = energy.by_lame()
    mu, lam = energy.lame
    local = bound * mu if math.isinf(lam) else lam * bound * mu / (lam + bound * mu)
    rest = psi.subs(LAME[1], LOCAL)
    volume = _volume_term(psi - rest, energy.measures, energy.of_stretches)
    if volume is None:
        raise BadInput(
            f"material '{energy.name}' has no volume term, one in J alone that brings lambda, "
            "which mixed elements need: take Q1, Q2, P1 or P2"
        )
    made = energy.at_pressure(rest, PRESSURE, {LOCAL: local})
    return Split(made, volume)


@lru_cache(maxsize=64)
def _volume_term(
    difference: sympy.Expr, measures: tuple[sympy.Symbol, ...], of_stretches: bool
) -> sympy.Expr | None:
    """Return ``difference`` = psi - psi' in J; None if it is 0 or depends on more than J."""
    terms = sympy.Add.make_args(sympy.expand(difference))
    volumes = [_of_volume(term, measures, of_stretches) for term in terms]
    if None in volumes and of_stretches:  # expanded, (log s0 + log s1 + log s2)^2 hides (log J)^2
        volumes = [_of_volume(difference, measures, of_stretches)]
    if None in volumes or sympy.Add(*volumes) == 0:
        return None
    # Factored: in the expanded J^2 - 2 J + 1, lambda times the rounding error would exceed p.
    return sympy.factor(sympy.simplify(sympy.Add(*volumes)))


def _of_volume(
    term: sympy.Expr, measures: tuple[sympy.Symbol, ...], of_stretches: bool
) -> sympy.Expr | None:
    """Return an additive term as a function of J, or None if it depends on another measure."""
    if of_stretches:
        a, b, c = sympy.symbols("a b J", positive=True)
        signless = dict(zip(SIGMA, (a, b, c / (a * b)), strict=True))
        term = sympy.simplify(sympy.expand_log(term.subs(signless, simultaneous=True)))
        return term.subs(c, J) if not term.free_symbols & {a, b} else None
    return term if term.free_symbols & set(measures) <= {J} else None
