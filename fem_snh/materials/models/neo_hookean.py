"""The Neo-Hookean energy of the textbooks."""

from __future__ import annotations

from typing import Any

from sympy import log


def neo_hookean(I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Neo-Hookean of Bonet & Wood 2008 (Smith et al. 2018, eq. 5): infinite for J <= 0.

    psi = mu/2 (I_C - 3) - mu log J + lam/2 (log J)^2
    """
    return mu / 2 * (I_C - 3) - mu * log(J) + lam / 2 * log(J) ** 2
