"""The material ``gent``."""

from typing import Annotated

from sympy.codegen.cfunctions import log1p

from fem_snh.errors import Range
from fem_snh.materials.invariants import exact
from fem_snh.materials.models._terms import first_invariant, volume_term
from fem_snh.materials.registry import bulk

PUBLISHED = (bulk("kappa"),)


def gent(
    I_C,
    J,
    mu,
    kappa,
    *,
    J_m: Annotated[float, Range(0, open_low=True)] = 77.931,
):
    """Gent's energy of rubber with a limit of its stretch (Gent 1996, eq. 1), with a volume term.

    ::

        psi = -mu J_m/2 log(1 - (I1 - 3)/J_m) + kappa/2 (J - 1)^2,  I1 = J^(-2/3) I_C

    Parameters
    ----------
    mu, kappa : sympy.Symbol
        Constants [Pa]: mu_lame = mu, lambda_lame = kappa - 2/3 mu.
    J_m : float
        The limit of I1 - 3. The default is fitted to Treloar's tension test (Ogden, Saccomandi &
        Sgura 2004) and locks at a stretch of 9.

    Notes
    -----
    Infinite for J <= 0, and where I1 - 3 >= J_m: no chain is longer than its contour. The limit
    J_m to infinity is a Neo-Hookean energy.

    References
    ----------
    Gent 1996.
    """
    limit = exact(J_m)
    x = first_invariant(I_C, J) - 3
    return -mu * limit / 2 * log1p(-x / limit) + volume_term(J, kappa)
