"""The material ``extended_tube``."""

from typing import Annotated, Any

from sympy import Rational
from sympy.codegen.cfunctions import log1p

from fem_snh.errors import Range
from fem_snh.materials.invariants import exact, positive
from fem_snh.materials.models._terms import first_invariant, volume_term
from fem_snh.materials.registry import bulk

PUBLISHED = (bulk("kappa"),)


def extended_tube(
    s0,
    s1,
    s2,
    Gc: Any = 0.1556,
    Ge: Any = 0.1808,
    kappa: Any = 1.0,
    *,
    # Beyond 1/sqrt 2 the shear modulus of Gc is negative.
    delta: Annotated[float, Range(0, 0.7, open_high=True)] = 0.09693,
    beta: Annotated[float, Range(0, 1, open_low=True)] = 0.2,
):
    """Extended tube energy of rubber (Kaliske & Heinrich 1999), with a volume term.

    ::

        psi = Gc/2 ((1 - delta^2) x / (1 - delta^2 x) + log(1 - delta^2 x))
              + 2 Ge/beta^2 sum (t_i^-beta - 1) + kappa/2 (J - 1)^2
        x = sum t_i^2 - 3,  t_i = J^(-1/3) s_i

    Parameters
    ----------
    Gc, Ge, kappa : sympy.Symbol
        Constants [Pa] of the cross-links, the entanglements and the volume: mu_lame = (1 - 2
        delta^2) Gc + Ge, lambda_lame = kappa - 2/3 mu_lame. Of all values that match E and nu,
        those nearest to E times the defaults are used. Each may be prescribed.
    delta : float
        Inextensibility of the chains, at least 0 and below 0.7; 0 is the tube model of Heinrich &
        Kaliske 1997.
    beta : float
        Release of the entanglements, above 0 and at most 1.

    Notes
    -----
    Infinite for J <= 0, and where x >= 1/delta^2: no chain is longer than its contour. The default
    parameters are the authors' for Treloar's rubber, with Gc = 0.1867 MPa and Ge = 0.2169 MPa.

    Gc + Ge is often printed as the shear modulus; the derivative at rest is (1 - 2 delta^2) Gc +
    Ge, 1 % less for the parameters of Treloar's rubber.

    References
    ----------
    Kaliske & Heinrich 1999.

    Heinrich & Kaliske 1997.
    """
    squared, power = exact(delta) ** 2, exact(beta)
    stretches = [positive(s) for s in (s0, s1, s2)]
    J = positive(s0 * s1 * s2)
    x = first_invariant(sum(s**2 for s in stretches), J) - 3
    links = Gc / 2 * ((1 - squared) * x / (1 - squared * x) + log1p(-squared * x))
    entanglements = J ** (power * Rational(1, 3)) * sum(s**-power for s in stretches) - 3
    return links + 2 * Ge / power**2 * entanglements + volume_term(J, kappa)
