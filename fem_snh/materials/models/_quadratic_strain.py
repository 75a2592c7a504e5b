"""What the energies that are quadratic in a strain have in common."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


def quadratic(strains: Sequence[Any], mu: Any, lam: Any) -> Any:
    """mu sum e_i^2 + lam/2 (sum e_i)^2 of principal strains with e = 0, de/ds = 1 at rest.

    The Seth-Hill and Hill families (Chen & Barbic, Table 1): mu = mu_lame, lam = lambda_lame.
    """
    return mu * sum(e**2 for e in strains) + lam / 2 * sum(strains) ** 2
