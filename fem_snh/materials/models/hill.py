"""The material ``hill``."""

from sympy import Symbol, simplify

from fem_snh.errors import BadInput
from fem_snh.materials.invariants import positive
from fem_snh.materials.models._terms import quadratic
from fem_snh.materials.parsing import parse


def hill(s0, s1, s2, mu, lam, *, strain: str = "log(s)"):
    """Hill's family: quadratic in any strain function (Chen & Barbic, Table 1).

    ::

        psi = mu sum f(s_i)^2 + lam/2 (sum f(s_i))^2

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa]: mu = mu_lame, lam = lambda_lame.
    strain : str
        f as an expression in s with numbers, + - * / ** ( ), log, exp, sqrt; f(1) = 0 and
        f'(1) = 1.

    Notes
    -----
    Infinite for J <= 0. The default, log(s), is `hencky`.

    References
    ----------
    Hill 1968.
    """
    s = Symbol("s", real=True)
    f = parse("strain", strain, {"s": s})
    if simplify(f.subs(s, 1)) != 0 or simplify(f.diff(s).subs(s, 1) - 1) != 0:
        raise BadInput(f"strain = {strain!r}: expected f(s) with f(1) = 0 and f'(1) = 1")
    strains = [f.subs(s, positive(x)) for x in (s0, s1, s2)]
    return quadratic(strains, mu, lam)
