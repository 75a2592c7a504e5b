"""As rigid as possible, in both directions."""

from __future__ import annotations

from typing import Any

from fem_snh.materials._functions import positive
from fem_snh.materials._volume import volume as volume_term


def symmetric_arap(
    I1: Any, I_C: Any, II_C: Any, J: Any, mu: Any, lam: Any, *, volume: str = "J"
) -> Any:
    """Symmetric ARAP (Shtengel et al. 2017; Chen & Barbic, Table 1), with a volume term.

    Infinite for J <= 0.

    psi = mu/2 (||F - R||^2 + ||F^-1 - R^-1||^2) + volume,
          the bracket = sum ((s_i - 1)^2 + (1/s_i - 1)^2)

    mu = mu_lame. It has nu = 0 by nature: the volume term ("J": lam/2 (J - 1)^2, "log": lam/2 (log
    J)^2) gives it another, and vanishes at nu = 0.
    """
    inverses = (I1**2 - I_C) / (2 * positive(J))  # sum 1/s_i
    there, back = I_C - 2 * I1 + 3, II_C / positive(J) ** 2 - 2 * inverses + 3
    return mu / 2 * (there + back) + volume_term(J, lam, volume)
