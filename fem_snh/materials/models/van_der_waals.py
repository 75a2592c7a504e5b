"""The material ``van_der_waals``."""

from typing import Annotated

from sympy import Rational, log, sqrt
from sympy.codegen.cfunctions import log1p

from fem_snh.errors import Range
from fem_snh.materials.invariants import exact, positive, where
from fem_snh.materials.models._terms import first_invariant, second_invariant, volume_term
from fem_snh.materials.registry import bulk

PUBLISHED = (bulk("kappa"),)
#: psi is a polynomial for x below this value: stretches within 0.6 % of 1. The Hessian of x^(3/2)
#: has a quotient of two quantities that vanish at rest; a smaller bound would amplify rounding.
SMALL = Rational(1, 10_000)


def van_der_waals(
    I_C,
    II_C,
    J,
    mu,
    kappa,
    *,
    lambda_m: Annotated[float, Range(1.74)] = 10.24,
    a: Annotated[float, Range(0)] = 0.32,
    beta: Annotated[float, Range(0, 1)] = 0.042,
):
    """Van der Waals energy of rubber (Kilian 1981; Enderle & Kilian 1987), with a volume term.

    ::

        psi = mu (-m (log(1 - y) + y) - 2/3 a (x/2)^(3/2)) + kappa/2 (J - 1)^2
        y = sqrt(x/m),  m = lambda_m^2 - 3,  x = (1 - beta) I1 + beta I2 - 3
        I1 = J^(-2/3) I_C,  I2 = J^(-4/3) II_C

    Parameters
    ----------
    mu, kappa : sympy.Symbol
        Constants [Pa]: mu_lame = mu, lambda_lame = kappa - 2/3 mu.
    lambda_m : float
        Locking stretch, at least 1.74 (above sqrt 3).
    a : float
        Global interaction of the chains, at least 0.
    beta : float
        Share of I2, from 0 to 1. Enderle & Kilian give it to I1 instead: their beta is 1 - beta.

    Notes
    -----
    Infinite for J <= 0, and where x >= lambda_m^2 - 3. The default parameters are those of
    Treloar's rubber in Marckmann & Verron 2006, with mu = 0.434 MPa.

    The third derivative of x^(3/2) is infinite at rest. For x < 1e-4, psi is therefore the
    polynomial in x with the same value and first two derivatives at 1e-4, and the same shear
    modulus at rest.

    References
    ----------
    Kilian 1981.

    Enderle & Kilian 1987.
    """
    m, attraction, share = exact(lambda_m) ** 2 - 3, exact(a), exact(beta)
    J = positive(J)
    first, second = first_invariant(I_C, J), second_invariant(II_C, J)
    x = (1 - share) * first + share * second - 3
    psi = where(x - SMALL, _network(x, m, attraction), _near_rest(x, m, attraction))
    return mu * psi + volume_term(J, kappa)


def _network(x, m, a):
    """Return psi/mu, without the volume term, as a function of x."""
    y = sqrt(1 - positive(1 - x / m))
    return -m * (log1p(-y) + y) - Rational(2, 3) * a * sqrt(x / 2) ** 3


def _near_rest(x, m, a):
    """Return the polynomial that continues psi/mu below `SMALL`: x/2 + c2 x^2 + c3 x^3 + c4 x^4."""
    y = sqrt(SMALL / m)
    # psi/mu - x/2 at SMALL, and its derivatives times SMALL and SMALL^2.
    value = -m * (log(1 - y) + y) - Rational(2, 3) * a * sqrt(SMALL / 2) ** 3 - SMALL / 2
    slope = SMALL * (y / (1 - y) - a * sqrt(SMALL / 2)) / 2
    curvature = SMALL * (y / (1 - y) ** 2 - a * sqrt(SMALL / 2)) / 4
    t = x / SMALL
    c2 = 6 * value - 3 * slope + curvature / 2
    c3 = -8 * value + 5 * slope - curvature
    c4 = 3 * value - 2 * slope + curvature / 2
    return x / 2 + t**2 * (c2 + t * (c3 + t * c4))
