"""Timoshenko's beam: the frequencies of a cantilever."""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq


def timoshenko(ratio, nu, count):
    """omega L^2 sqrt(rho A/(E I)) of a cantilever of thickness 1 and length ``ratio``.

    E I w'' = ..., with rotary inertia r^2 = I/(A L^2) and shear s^2 = E I/(k G A L^2), k = 5/6:
    Huang 1961's frequency equation, below the cut-off.
    """
    r2 = 1 / 12 / ratio**2
    s2 = r2 * 2 * (1 + nu) * 6 / 5

    def equation(b):
        root = np.sqrt((r2 - s2) ** 2 + 4 / b**2)
        al, be = np.sqrt((-(r2 + s2) + root) / 2), np.sqrt((r2 + s2 + root) / 2)
        c, ch = np.cos(b * be), np.cosh(b * al)
        s, sh = np.sin(b * be), np.sinh(b * al)
        return (
            2
            + (b**2 * (r2 - s2) ** 2 + 2) * ch * c
            - b * (r2 + s2) / np.sqrt(1 - b**2 * r2 * s2) * sh * s
        )

    grid = np.linspace(0.5, 80, 2000)
    signs = [equation(b) for b in grid]
    roots = [
        brentq(equation, a, b)
        for a, b, fa, fb in zip(grid, grid[1:], signs, signs[1:], strict=False)
        if fa * fb < 0
    ]
    return np.array(roots[:count])
