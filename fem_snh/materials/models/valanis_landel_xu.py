"""The Valanis-Landel form of lengths, areas and volume."""

from __future__ import annotations

from typing import Any

from sympy import log, symbols

from fem_snh.materials.functions import positive
from fem_snh.materials.parsing import parse


def valanis_landel_xu(
    s0: Any,
    s1: Any,
    s2: Any,
    mu: Any,
    lam: Any,
    *,
    length: str = "s * (log(s) - 1)",
    area: str = "a * (log(a) - 1) / 4",
    volume: str = "(J - 1)**2 / 2",
) -> Any:
    """Valanis-Landel of lengths, areas and volume (Xu et al. 2015; Chen & Barbic, Table 1).

    Infinite for J <= 0.

    psi = mu (sum f(s_i) + sum g(s_i s_j) - (f'(1) + 2 g'(1)) log J) + lam (h(J) - h'(1) log J)

    length: f as an expression in s; area: g in a; volume: h in J; of numbers, + - * / ** ( ), log,
    exp, sqrt. Each pair of stretches counts once. The logarithms complete functions whose slope at
    rest is not zero, so that the rest state is free of stress.
    """
    s, a, x = symbols("s a J", real=True)
    f, g, h = parse(length, {"s": s}), parse(area, {"a": a}), parse(volume, {"J": x})
    stretches = [positive(y) for y in (s0, s1, s2)]
    pairs = [stretches[i] * stretches[j] for i, j in ((0, 1), (0, 2), (1, 2))]
    J = stretches[0] * stretches[1] * stretches[2]
    slope = f.diff(s).subs(s, 1) + 2 * g.diff(a).subs(a, 1)
    one = sum(f.subs(s, y) for y in stretches) + sum(g.subs(a, y) for y in pairs)
    return mu * (one - slope * log(J)) + lam * (h.subs(x, J) - h.diff(x).subs(x, 1) * log(J))
