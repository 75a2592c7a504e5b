"""Mooney-Rivlin with a volume term."""

from __future__ import annotations

from typing import Any

from sympy import Rational


def mooney_rivlin(
    I_C: Any, II_C: Any, J: Any, C1: Any = 0.125, C2: Any = 0.0417, kappa: Any = 1.0
) -> Any:
    """Mooney-Rivlin (Chen & Barbic, Table 1), completed by a volume term: infinite for J <= 0.

    psi = C1 (J^(-2/3) I_C - 3) + C2 (J^(-4/3) II_C - 3) + kappa/2 (J - 1)^2

    mu_lame = 2 (C1 + C2), lambda_lame = kappa - 4/3 (C1 + C2): without the volume term lambda_lame
    would be negative. Three constants: the default moves C1 and C2 least from 1/8 E and 1/24 E;
    any of them may be given [Pa].
    """
    isochoric = C1 * (J ** Rational(-2, 3) * I_C - 3) + C2 * (J ** Rational(-4, 3) * II_C - 3)
    return isochoric + kappa / 2 * (J - 1) ** 2
