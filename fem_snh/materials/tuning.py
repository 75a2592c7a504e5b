r"""Tune an energy: change its nonlinearity, or combine the parts of two energies.

Nonlinearity (Chen & Barbic, eq. 16): :math:`\psi_\alpha(s) = \psi(s^\alpha) / \alpha^2` leaves the
small-strain constants unchanged. The power is undefined for an inverted element, so it is extended
to an odd function g of the stretch:

.. math::

    g(s) = s \, \exp\!\left(\tfrac{\alpha - 1}{2} \, \ell(s^2)\right), \qquad
    \ell(z) = \begin{cases}
        \log z & z \ge \epsilon^2 \\
        \text{cubic Taylor polynomial of log at } \epsilon^2 & z < \epsilon^2
    \end{cases}

For s >= epsilon, g(s) is exactly s^alpha. For z < epsilon^2, let w = 1 - z/epsilon^2, which lies in
(0, 1]. Then z l'(z) = 1 - w^3 lies in [0, 1), and g' = exp(...) (1 + (alpha - 1)(1 - w^3)) lies
between exp(...) and alpha exp(...), so g' > 0 for every alpha > 0. Therefore g is odd, three times
differentiable, strictly increasing and onto. If psi is finite and smooth for every F, then:

- psi(g)/alpha^2 is finite and has continuous third derivatives.
- g maps its stationary stretches to the stationary stretches of psi. They are of the same kind,
  because the Hessian G' H G' is congruent to H: no spurious minimum is added.
- Any stretch may carry the negative sign, because g is odd.

Mixing (Chen & Barbic, eq. 19, 20): the mu part of one energy and the lambda part of another, each
with its own alpha.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.energy import LAME, Energy
from fem_snh.materials.invariants import INVARIANTS, SIGMA, exact, where
from fem_snh.materials.normalise import lame

Pair = tuple[sympy.Expr, sympy.Expr]
#: An energy (None for a stress without an energy) and its three principal stresses.
Part = tuple[sympy.Expr | None, tuple[sympy.Expr, ...]]

#: Default stretch below which s^alpha is extended, for energies that are finite for every F.
EPSILON = 0.1


def tune(energy: Energy, tuning: Mapping[str, Any], other: Energy | None) -> Energy:
    """Return an energy with another nonlinearity, or with the lambda part of another energy.

    Parameters
    ----------
    energy : Energy
        The energy that supplies the mu part.
    tuning : mapping
        Values from `fem_snh.materials.parameters.check`.
    other : Energy, optional
        The energy that supplies the lambda part; by default ``energy`` itself.

    Returns
    -------
    Energy
        Written in the principal stretches, or ``energy`` itself if the tuning changes nothing.

    Raises
    ------
    BadInput
        If an energy has to be split into a mu part and a lambda part and cannot.
    """
    alphas = tuning["alpha_mu"], tuning["alpha_lambda"]
    if other is None and alphas == (1, 1):
        return energy
    constants, values = energy.constants, energy.values
    if other is None and alphas[0] == alphas[1]:
        epsilon = _epsilon(tuning, energy)
        psi, stress = nonlinear(energy.psi_sigma, energy.slopes, alphas[0], epsilon)
    else:
        mu, lam = LAME
        epsilon = _epsilon(tuning, energy, other or energy)
        psi_mu, slopes_mu = _parts(energy)[0]
        psi_lam, slopes_lam = _parts(other or energy)[1]
        a = nonlinear(psi_mu, slopes_mu, alphas[0], epsilon)
        b = nonlinear(psi_lam, slopes_lam, alphas[1], epsilon)
        psi = None if None in (a[0], b[0]) else mu * a[0] + lam * b[0]
        stress = tuple(mu * p + lam * q for p, q in zip(a[1], b[1], strict=True))
        constants, values = LAME, lame(energy.E, energy.nu)
    barriers = energy.domain if other is None else (*energy.domain, *other.domain)
    return replace(
        energy,
        measures=SIGMA,
        constants=constants,
        values=values,
        psi=psi,
        stress=None if psi is not None else stress,
        barriers=frozenset(b.subs(INVARIANTS) for b in barriers),
    )


def _epsilon(tuning: Mapping[str, Any], *energies: Energy) -> float:
    """Return the stretch below which s^alpha is extended.

    The default is `EPSILON`; 0 if an energy is not finite for every F.
    """
    if tuning["epsilon"] is not None:
        return float(tuning["epsilon"])
    return EPSILON if all(e.inversion_safe for e in energies) else 0


def _parts(energy: Energy) -> tuple[Part, ...]:
    """Return (psi, slopes) of the mu part divided by mu and of the lambda part over lambda."""
    mu, lam = LAME
    solution = energy.fit.solve((mu, lam), energy.E)
    numbers = dict(zip(energy.constants, solution, strict=True))
    if energy.psi is None:
        pairs = split_moduli(energy.name, [p.subs(numbers) for p in energy.slopes], mu, lam)
        return tuple((None, slopes) for slopes in zip(*pairs, strict=True))
    ((own, other),) = split_moduli(energy.name, [energy.psi_sigma.subs(numbers)], mu, lam)
    return tuple((p, tuple(sympy.diff(p, s) for s in SIGMA)) for p in (own, other))


def stretch_power(s: sympy.Expr, alpha: float, epsilon: float) -> sympy.Expr:
    """Return g(s) of the module: s^alpha, extended for s < ``epsilon`` unless that is 0."""
    if alpha == 1:
        return s
    a = exact(alpha)
    if epsilon == 0:
        return s**a
    z, e = s**2, exact(epsilon) ** 2
    w = z / e - 1
    ell = where(z - e, sympy.log(z), sympy.log(e) + w - w**2 / 2 + w**3 / 3)
    return s * sympy.exp((a - 1) / 2 * ell)


def nonlinear(
    psi: sympy.Expr | None, slopes: Sequence[sympy.Expr], alpha: float, epsilon: float
) -> tuple[sympy.Expr | None, tuple[sympy.Expr, ...]]:
    """Return psi_alpha (None if psi is) and its three principal stresses, in the stretches.

    References
    ----------
    Chen & Barbic, eq. 16, 17.
    """
    if alpha == 1:
        return psi, tuple(slopes)
    # Plain powers are for positive stretches only: (s^2)^1.3 becomes s^2.6, not |s|^2.6.
    stretches = SIGMA if epsilon else sympy.symbols("t0 t1 t2", positive=True)
    power = [stretch_power(s, alpha, epsilon) for s in stretches]
    swap = dict(zip(SIGMA, power, strict=True))
    back = dict(zip(stretches, SIGMA, strict=True))
    a2 = exact(alpha) ** 2

    def moved(expression: sympy.Expr) -> sympy.Expr:
        return expression.subs(swap, simultaneous=True) / a2

    pulled = tuple(
        (sympy.diff(g, s) * moved(p)).xreplace(back)
        for p, g, s in zip(slopes, power, stretches, strict=True)
    )
    return (None if psi is None else moved(psi).xreplace(back)), pulled


def split_moduli(
    name: str, expressions: Sequence[sympy.Expr], mu: sympy.Symbol, lam: sympy.Symbol
) -> list[Pair]:
    """Return the (mu part, lambda part) of each expression, divided by mu and lambda.

    Raises BadInput if an expression is not mu times one function plus lambda times another
    (Chen & Barbic, eq. 19).
    """
    found = []
    for expression in expressions:
        # A quotient may contain the symbols although they cancel: substituting 1 removes them.
        own, other = (sympy.diff(expression, x).subs({mu: 1, lam: 1}) for x in (mu, lam))
        if sympy.simplify(expression - mu * own - lam * other) != 0:
            raise BadInput(
                f"material '{name}' is not a sum of a mu part and a lambda part (Chen & Barbic "
                "eq. 19): it takes one alpha, and no lambda_part"
            )
        found.append((own, other))
    return found
