"""The original Valanis-Landel energy."""

from __future__ import annotations

from typing import Any

from sympy import log


def valanis_landel(s0: Any, s1: Any, s2: Any, mu: Any, lam: Any) -> Any:
    """Valanis & Landel 1967 (Chen & Barbic, Table 1): infinite for J <= 0.

    psi = 2 mu sum s_i (log s_i - 1) + lam/2 (log J)^2

    mu = mu_lame, lam = lambda_lame. Its stress grows as log s: soft in extension.
    """
    logs = [log(s) for s in (s0, s1, s2)]
    length = sum(s * (x - 1) for s, x in zip((s0, s1, s2), logs, strict=True))
    return 2 * mu * length + lam / 2 * sum(logs) ** 2
