"""What can be done to any energy: more or less nonlinear, and parts of two put together.

Nonlinearity (Chen & Barbic, eq. 16): psi_alpha(s) = psi(s^alpha) / alpha^2, the linear properties
untouched. As printed s^alpha is undefined for an inverted element. Here it is extended::

    g(s) = s exp((alpha - 1)/2 ell(s^2)),   ell(z) = log z                          for z >= eps^2
                                                     its cubic Taylor polynomial at eps^2, below

g(s) = s^alpha for s >= eps, exactly. Below, with w = 1 - z/eps^2 in (0, 1] and
z ell'(z) = 1 - w^3 in [0, 1), g' = exp(...) (1 + (alpha - 1)(1 - w^3)) lies between exp(...) and
alpha exp(...): positive, for every alpha > 0. So g is odd, three times differentiable, strictly
increasing and onto. Hence of an energy psi that is finite and smooth for every F, psi(g)/alpha^2
is finite and has continuous third derivatives; its stationary stretches are those of psi, moved
by g, and of the same kind (the Hessian there, G' H G', is congruent): no spurious minimum is added;
and as g is odd, the sign may be carried by any stretch, as before.

Mixing (eq. 19, 20): the lambda part of one material with the mu part of another, each with its own
alpha.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import sympy

from fem_snh.errors import BadInput
from fem_snh.materials.functions import exact, where
from fem_snh.materials.invariants import SIGMA

#: Keywords of every material, with their defaults.
TUNING: dict[str, float | str | None] = {
    "alpha": 1.0,
    "alpha_mu": None,
    "alpha_lambda": None,
    "lambda_part": None,
    "epsilon": None,
}
#: Stretch below which s^alpha is extended, where the energy is finite for inverted elements.
EPSILON = 0.1


def check(tuning: dict[str, Any]) -> dict[str, Any]:
    """``tuning`` with what is missing or None at its default; alphas of the parts resolved.

    Raises BadInput for an alpha that is not positive or a negative epsilon.
    """
    given = TUNING | {k: v for k, v in tuning.items() if v is not None}
    for key in ("alpha_mu", "alpha_lambda"):
        given[key] = given["alpha"] if given[key] is None else given[key]
    for key in ("alpha", "alpha_mu", "alpha_lambda", "epsilon"):
        value = given[key]
        if value is None:
            continue
        number = isinstance(value, int | float) and not isinstance(value, bool)
        low = 0 if key == "epsilon" else 1e-9
        if not (number and low <= value < float("inf")):
            wanted = "a number >= 0" if key == "epsilon" else "a number > 0"
            raise BadInput(f"{key} = {value!r}: expected {wanted}")
    return given


def stretch_power(s: sympy.Expr, alpha: float, epsilon: float) -> sympy.Expr:
    """g(s): s^alpha, extended below ``epsilon`` (module docstring); the bare power for 0."""
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
    """Energy and principal stresses of psi_alpha (eq. 16, 17), all in the stretches."""
    if alpha == 1:
        return psi, tuple(slopes)
    # Bare powers are for positive stretches alone: so (s^2)^1.3 is s^2.6, and not |s|^2.6.
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


def parts(name: str, expressions: Sequence[sympy.Expr], mu: Any, lam: Any) -> list[Any]:
    """The (mu part, lambda part) of each expression in the symbols mu, lam (eq. 19).

    Raises BadInput where an expression is not a sum of the two.
    """
    found = []
    for expression in expressions:
        # What does not depend on the symbols may have them in it uncancelled: at 1 they are gone.
        own, other = (sympy.diff(expression, x).subs({mu: 1, lam: 1}) for x in (mu, lam))
        if sympy.simplify(expression - mu * own - lam * other) != 0:
            raise BadInput(
                f"material '{name}' is not a sum of a mu part and a lambda part (Chen & Barbic "
                "eq. 19): it takes one alpha, and no lambda_part"
            )
        found.append((own, other))
    return found
