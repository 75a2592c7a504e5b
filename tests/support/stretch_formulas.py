"""Principal stretches, and parts of the published formulas in them."""

from __future__ import annotations

NU = 0.3
STATES = [(1.3, 0.9, 0.8), (2.1, 0.7, 0.6), (1.0, 1.0, 0.4), (0.7, 0.8, 0.9)]


def sums(s):
    return sum(s), sum(x**2 for x in s), s[0] * s[1] * s[2]


def green(s):
    return [(x**2 - 1) / 2 for x in s]


def strains(f):
    """mu sum f(s)^2 + lambda/2 (sum f(s))^2: the Seth-Hill and Hill families."""
    return lambda s, mu, lam: mu * sum(f(x) ** 2 for x in s) + lam / 2 * sum(map(f, s)) ** 2


def areas(s):
    return s[0] * s[1], s[0] * s[2], s[1] * s[2]
