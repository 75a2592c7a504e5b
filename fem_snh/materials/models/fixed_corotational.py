"""The "fixed" corotational energy of Stomakhin et al. 2012."""

from __future__ import annotations

from typing import Any


def fixed_corotational(I1: Any, I_C: Any, J: Any, mu: Any, lam: Any) -> Any:
    """Fixed corotational of Stomakhin et al. 2012 (Smith et al. 2018, eq. 49).

    psi = mu ||F - R||^2 + lam/2 (J - 1)^2,  ||F - R||^2 = I_C - 2 I1 + 3,  I1 = tr S

    It needs the stretches (I1), and has no Hessian where two signed stretches sum to zero.
    """
    return mu * (I_C - 2 * I1 + 3) + lam / 2 * (J - 1) ** 2
