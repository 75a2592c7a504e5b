"""Volume terms for the families whose energy has nu = 0 (Chen & Barbic, section 6)."""

from sympy import log

from fem_snh.errors import choose

_TERMS = {
    "J": lambda J, lam: lam / 2 * (J - 1) ** 2,
    "log": lambda J, lam: lam / 2 * log(J) ** 2,
}


def volume(J, lam, kind: str):
    """Return the volume term ``kind``: "J" is lam/2 (J - 1)^2, "log" is lam/2 (log J)^2.

    Raises BadInput for another kind.
    """
    return _TERMS[choose("volume term", kind, list(_TERMS))](J, lam)
