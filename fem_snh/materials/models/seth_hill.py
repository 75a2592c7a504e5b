"""The material ``seth_hill``."""

from typing import Annotated

from fem_snh.materials.invariants import exact, positive
from fem_snh.materials.models._terms import quadratic
from fem_snh.materials.parameters import EXPONENTS


def seth_hill(s0, s1, s2, mu, lam, *, n: Annotated[float, EXPONENTS] = 0.5):
    """Seth-Hill family: quadratic in a power strain (Chen & Barbic, Table 1).

    ::

        psi = mu sum e_i^2 + lam/2 (sum e_i)^2,  e_i = (s_i^n - 1)/n

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    n : float
        Exponent, not 0: 1 is `corotational`, 2 is `stvk`, the limit n -> 0 is `hencky`.

    Notes
    -----
    Finite for every F if n is a positive whole number, otherwise infinite for J <= 0.

    References
    ----------
    Seth 1964.
    """
    power = exact(n)
    bases = (s0, s1, s2) if n > 0 else map(positive, (s0, s1, s2))
    strains = [(s**power - 1) / power for s in bases]
    return quadratic(strains, mu, lam)
