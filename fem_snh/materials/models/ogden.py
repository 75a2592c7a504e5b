"""Ogden's sum of powers."""

from __future__ import annotations

from typing import Any

from sympy import log

from fem_snh.errors import BadInput
from fem_snh.materials.functions import exact, positive
from fem_snh.materials.models._volume_term import volume as volume_term


def ogden(
    s0: Any,
    s1: Any,
    s2: Any,
    mu: Any,
    lam: Any,
    *,
    exponents: tuple[float, ...] = (1.3, 5.0, -2.0),
    weights: tuple[float, ...] = (6.3, 0.012, -0.1),
    volume: str = "J",
) -> Any:
    """Ogden 1972 (Chen & Barbic, Table 1), completed so that it rests, with a volume term.

    Infinite for J <= 0.

    psi = sum_p mu_p/a_p (s0^a_p + s1^a_p + s2^a_p - 3) - (sum_p mu_p) log J + volume

    exponents: the a_p; weights: the mu_p, up to a factor that is fitted: mu_p = mu w_p / (sum w_p
    a_p / 2), so mu = mu_lame. As printed in the table, without the logarithm, the rest state is
    stressed by sum mu_p, and mu_lame = sum mu_p (a_p - 1)/2. The defaults are Ogden's for Treloar's
    rubber. It has nu = 0 by nature: the volume term ("J": lam/2 (J - 1)^2, "log": lam/2 (log J)^2)
    gives it another, and vanishes at nu = 0.
    """
    if len(exponents) != len(weights) or not exponents:
        raise BadInput(
            f"ogden: {len(exponents)} exponents and {len(weights)} weights: they go in pairs"
        )
    powers, shares = ([exact(x) for x in xs] for xs in (exponents, weights))
    modulus = sum(w * a for w, a in zip(shares, powers, strict=True)) / 2
    if 0 in powers or modulus <= 0:
        raise BadInput(
            f"exponents {tuple(exponents)}, weights {tuple(weights)}: no exponent may be 0, and "
            "the sum of their products must be positive"
        )
    J = positive(s0 * s1 * s2)
    terms = [
        w / a * (positive(s0) ** a + positive(s1) ** a + positive(s2) ** a - 3)
        for w, a in zip(shares, powers, strict=True)
    ]
    return mu / modulus * (sum(terms) - sum(shares) * log(J)) + volume_term(J, lam, volume)
