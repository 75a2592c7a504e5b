"""The material ``mooney_rivlin``."""

from typing import Any

from fem_snh.materials.models._terms import first_invariant, second_invariant, volume_term
from fem_snh.materials.registry import bulk, renamed

PUBLISHED = (
    renamed("C10", "C1", "Coefficient of I1 - 3 [Pa]"),
    renamed("C01", "C2", "Coefficient of I2 - 3 [Pa]"),
    bulk("kappa"),
)


def mooney_rivlin(I_C, II_C, J, C1: Any = 0.125, C2: Any = 0.0417, kappa: Any = 1.0):
    """Mooney-Rivlin energy (Chen & Barbic, Table 1), with a volume term.

    ::

        psi = C1 (J^(-2/3) I_C - 3) + C2 (J^(-4/3) II_C - 3) + kappa/2 (J - 1)^2

    Parameters
    ----------
    C1, C2, kappa : sympy.Symbol
        Constants [Pa]: mu_lame = 2 (C1 + C2), lambda_lame = kappa - 4/3 (C1 + C2). Of all values
        that match E and nu, those nearest to the defaults E/8, E/24 and E are used. Each may be
        prescribed.

    Notes
    -----
    Infinite for J <= 0. Without the volume term lambda_lame would be negative.
    """
    first, second = first_invariant(I_C, J), second_invariant(II_C, J)
    return C1 * (first - 3) + C2 * (second - 3) + volume_term(J, kappa)
