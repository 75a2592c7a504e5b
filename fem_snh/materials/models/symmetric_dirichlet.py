"""The Dirichlet energy of a map and of its inverse."""

from __future__ import annotations

from typing import Any

from fem_snh.materials.functions import positive
from fem_snh.materials.models._volume_term import volume as volume_term


def symmetric_dirichlet(
    I_C: Any, II_C: Any, J: Any, mu: Any, lam: Any, *, volume: str = "J"
) -> Any:
    """Symmetric Dirichlet (Smith & Schaefer 2015; Chen & Barbic, Table 1), with a volume term.

    Infinite for J <= 0.

    psi = mu/4 (||F||^2 + ||F^-1||^2 - 6) + volume = mu/4 (I_C + II_C/J^2 - 6) + volume

    mu = mu_lame (the table's factor 1/2 gives mu_lame = 2). It has nu = 0 by nature: the volume
    term ("J": lam/2 (J - 1)^2, "log": lam/2 (log J)^2) gives it another, and vanishes at nu = 0.
    """
    return mu / 4 * (I_C + II_C / positive(J) ** 2 - 6) + volume_term(J, lam, volume)
