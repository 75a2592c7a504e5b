"""The symmetric Seth-Hill family of strains."""

from __future__ import annotations

from typing import Any

from fem_snh.errors import BadInput
from fem_snh.materials.functions import exact, positive
from fem_snh.materials.models._quadratic_strain import quadratic


def symmetric_seth_hill(s0: Any, s1: Any, s2: Any, mu: Any, lam: Any, *, n: float = 1.0) -> Any:
    """Symmetric Seth-Hill strains (Bazant 1998; Chen & Barbic, Table 1): infinite for J <= 0.

    psi = mu sum e_i^2 + lam/2 (sum e_i)^2,  e_i = (s_i^n - s_i^-n)/(2 n)

    n: not 0 (the limit is `hencky`). A stretch and its inverse cost the same. mu = mu_lame,
    lam = lambda_lame.
    """
    if n == 0:
        raise BadInput("n = 0: symmetric_seth_hill divides by it; its limit is 'hencky'")
    power = exact(n)
    strains = [(positive(s) ** power - positive(s) ** -power) / (2 * power) for s in (s0, s1, s2)]
    return quadratic(strains, mu, lam)
