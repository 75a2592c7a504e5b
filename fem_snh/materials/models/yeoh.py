"""The material ``yeoh``."""

from typing import Any

from fem_snh.materials.models._terms import first_invariant, volume_term
from fem_snh.materials.registry import bulk

PUBLISHED = (bulk("kappa"),)


def yeoh(I_C, J, C10: Any = 0.16667, C20: Any = -0.00176, C30: Any = 4.35e-5, kappa: Any = 1.0):
    """Yeoh's energy of filled rubber (Yeoh 1993, eq. 4), with a volume term.

    ::

        psi = C10 (I1 - 3) + C20 (I1 - 3)^2 + C30 (I1 - 3)^3 + kappa/2 (J - 1)^2
        I1 = J^(-2/3) I_C

    Parameters
    ----------
    C10, C20, C30, kappa : sympy.Symbol
        Constants [Pa]: mu_lame = 2 C10, lambda_lame = kappa - 4/3 C10. E and nu determine C10 and
        kappa. C20 and C30 are E times their defaults, from a least-squares fit to Treloar's
        tension test. Each may be prescribed.

    Notes
    -----
    Infinite for J <= 0. The energy stiffens without a limit, and increases with I1 for every
    stretch if C20^2 < 3 C10 C30.

    References
    ----------
    Yeoh 1993.
    """
    x = first_invariant(I_C, J) - 3
    return C10 * x + C20 * x**2 + C30 * x**3 + volume_term(J, kappa)
