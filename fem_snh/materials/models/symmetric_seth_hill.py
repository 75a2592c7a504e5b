"""The material ``symmetric_seth_hill``."""

from typing import Annotated

from fem_snh.materials.invariants import exact, positive
from fem_snh.materials.models._terms import quadratic
from fem_snh.materials.parameters import EXPONENTS


def symmetric_seth_hill(s0, s1, s2, mu, lam, *, n: Annotated[float, EXPONENTS] = 1.0):
    """Symmetric Seth-Hill family (Chen & Barbic, Table 1).

    ::

        psi = mu sum e_i^2 + lam/2 (sum e_i)^2,  e_i = (s_i^n - s_i^-n)/(2 n)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    n : float
        Exponent, not 0; the limit n -> 0 is `hencky`.

    Notes
    -----
    Infinite for J <= 0. A stretch and its inverse have the same energy.

    References
    ----------
    Bazant 1998.
    """
    power = exact(n)
    strains = [(positive(s) ** power - positive(s) ** -power) / (2 * power) for s in (s0, s1, s2)]
    return quadratic(strains, mu, lam)
