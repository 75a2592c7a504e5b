"""The material ``valanis_landel_xu``."""

from sympy import log, symbols

from fem_snh.materials.invariants import positive
from fem_snh.materials.parsing import parse


def valanis_landel_xu(
    s0,
    s1,
    s2,
    mu,
    lam,
    *,
    length: str = "s * (log(s) - 1)",
    area: str = "a * (log(a) - 1) / 4",
    volume: str = "(J - 1)**2 / 2",
):
    """Valanis-Landel energy of any functions of length, area and volume (Chen & Barbic, Table 1).

    ::

        psi = mu (sum f(s_i) + sum g(s_i s_j) - (f'(1) + 2 g'(1)) log J) + lam (h(J) - h'(1) log J)

    Parameters
    ----------
    mu, lam : sympy.Symbol
        Constants [Pa].
    length : str
        f as an expression in s with numbers, + - * / ** ( ), log, exp, sqrt.
    area : str
        g as an expression in a with the same operations; each pair of stretches counts once.
    volume : str
        h as an expression in J with the same operations.

    Notes
    -----
    Infinite for J <= 0. The logarithms make the rest state free of stress.

    References
    ----------
    Xu et al. 2015.
    """
    s, a, x = symbols("s a J", real=True)
    f = parse("length", length, {"s": s})
    g, h = parse("area", area, {"a": a}), parse("volume", volume, {"J": x})
    stretches = [positive(y) for y in (s0, s1, s2)]
    pairs = [stretches[i] * stretches[j] for i, j in ((0, 1), (0, 2), (1, 2))]
    J = stretches[0] * stretches[1] * stretches[2]
    slope = f.diff(s).subs(s, 1) + 2 * g.diff(a).subs(a, 1)
    one = sum(f.subs(s, y) for y in stretches) + sum(g.subs(a, y) for y in pairs)
    return mu * (one - slope * log(J)) + lam * (h.subs(x, J) - h.diff(x).subs(x, 1) * log(J))
