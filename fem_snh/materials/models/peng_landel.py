"""The Peng-Landel energy."""

from __future__ import annotations

from typing import Any

from sympy import log

from fem_snh.materials.models._volume_term import volume as volume_term


def peng_landel(s0: Any, s1: Any, s2: Any, mu: Any, lam: Any, *, volume: str = "J") -> Any:
    """Peng & Landel 1972 (Chen & Barbic, Table 1), with a volume term: infinite for J <= 0.

    psi = 3 mu sum (s_i - 1 - log s_i - (log s_i)^2/6 + (log s_i)^3/18 - (log s_i)^4/216) + volume

    Its -log^4 falls without bound as a stretch goes to 0. 3 mu is their E; mu = mu_lame. It has
    nu = 0 by nature: the volume term ("J": lam/2 (J - 1)^2, "log": lam/2 (log J)^2) gives it
    another, and vanishes at nu = 0.
    """
    length = sum(
        s - 1 - log(s) - log(s) ** 2 / 6 + log(s) ** 3 / 18 - log(s) ** 4 / 216
        for s in (s0, s1, s2)
    )
    return 3 * mu * length + volume_term(s0 * s1 * s2, lam, volume)
