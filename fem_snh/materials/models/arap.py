"""As rigid as possible."""

from __future__ import annotations

from typing import Any

from fem_snh.materials.models._volume_term import volume as volume_term


def arap(I1: Any, I_C: Any, J: Any, mu: Any, lam: Any, *, volume: str = "J") -> Any:
    """As rigid as possible (Sorkine & Alexa 2007; Chen & Barbic, Table 1), with a volume term.

    psi = mu ||F - R||^2 + volume,  ||F - R||^2 = I_C - 2 I1 + 3

    mu = mu_lame. It has nu = 0 by nature: the volume term ("J": lam/2 (J - 1)^2, "log": lam/2 (log
    J)^2) gives it another, and vanishes at nu = 0. With "J" it is `fixed_corotational`.
    """
    return mu * (I_C - 2 * I1 + 3) + volume_term(J, lam, volume)
