"""Volume terms for families that have none: nu = 0 by nature (Chen & Barbic, section 6)."""

from __future__ import annotations

from typing import Any

from sympy import log

from fem_snh.errors import choose

_TERMS = {
    "J": lambda J, lam: lam / 2 * (J - 1) ** 2,
    "log": lambda J, lam: lam / 2 * log(J) ** 2,
}


def volume(J: Any, lam: Any, kind: str) -> Any:
    """The lambda part called ``kind``: "J": lam/2 (J - 1)^2, "log": lam/2 (log J)^2.

    Raises BadInput for another kind.
    """
    return _TERMS[choose("volume term", kind, list(_TERMS))](J, lam)
