"""Logarithmic strain."""

from __future__ import annotations

from typing import Any

from sympy import log

from fem_snh.materials.models._quadratic_strain import quadratic


def hencky(s0: Any, s1: Any, s2: Any, mu: Any, lam: Any) -> Any:
    """Hencky's energy (Chen & Barbic, Table 1).

    Quadratic in the logarithmic strain, infinite for J <= 0.

    psi = mu sum (log s_i)^2 + lam/2 (log J)^2

    mu = mu_lame, lam = lambda_lame. The limit of `seth_hill` for n -> 0; the nonlinearity alpha
    leaves it as it is. It softens beyond a stretch of e.
    """
    return quadratic([log(s) for s in (s0, s1, s2)], mu, lam)
