"""Velocity and acceleration of a prescribed motion, as a step in time sees them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]

#: Points of the polynomial that a smooth motion follows: exact up to degree 5 in time.
_POINTS = 6
#: Largest misfit of that polynomial between its points, relative to the largest change of velocity
#: in a step times the step. A motion of constant frequency has 1e-4 at 6 steps a period. So has a
#: table with a point every 0.03 steps, whose kinks then change the acceleration by 0.2 %.
_SMOOTH = 1e-4
#: The same, relative to the displacement: rounding.
_ROUNDING = 1e-14
#: Rounding of the last load, 1, to which steps add up.
_LAST = 1 + 1e-9


def path_rates(
    path: Callable[[float], Array], load: float, step: float
) -> tuple[Array, Array, Array]:
    r"""Return a motion at a load, and its first two derivatives by the load.

    Where the motion is smooth within a step of the load, they are those of a polynomial through
    points of it. Where it has kinks, as a table between its points, they are the central
    differences of the step,

    .. math:: v = \frac{u_{n+1} - u_{n-1}}{2 h}, \qquad a = \frac{u_{n+1} - 2 u_n + u_{n-1}}{h^2} .

    The sum of :math:`h a` over steps is then the change of the velocity, and the work of the
    inertial forces by the trapezoidal rule the change of the kinetic energy, wherever the kinks
    are. At the last load, beyond which a motion is not known, they are one-sided.

    Parameters
    ----------
    path : callable
        The motion, an array as a function of the load. Collective if it is.
    load : float
        The load.
    step : float
        The size of the step that ends at the load; negative at the start of the first one, for
        points at higher loads alone.
    """
    u = path(load)
    if step < 0:
        window, points = (-1.0, 0.0), np.arange(-1, 1)
    elif load + step <= _LAST:
        window, points = (-1.0, 1.0), np.arange(-1, 2)
    else:
        behind = load / step
        window, points = (-min(2.0, behind), 0.0), np.arange(-min(3, round(behind)), 1)

    def changes(offsets: Array) -> Array:
        """Return the changes of the motion at some steps from the load, (offsets, ...)."""
        # Differences from the present value: a constant displacement has no rounding error.
        return np.stack([path(load + k * step) - u if k else np.zeros_like(u) for k in offsets])

    fine = np.linspace(*window, _POINTS)
    between = (fine[1:] + fine[:-1]) / 2
    values = changes(fine)
    v, a = np.tensordot(_derivatives(fine), values, axes=1)
    expected = np.tensordot(_interpolation(fine, between), values, axes=1)
    misfit = abs(changes(between) - expected).max(axis=0)
    bend = abs(np.diff(values, 2, axis=0)).max(axis=0) / (fine[1] - fine[0]) ** 2
    smooth = misfit <= _SMOOTH * bend + _ROUNDING * abs(u)
    coarse_v, coarse_a = np.tensordot(_derivatives(points), changes(points), axes=1)
    v, a = np.where(smooth, v, coarse_v), np.where(smooth, a, coarse_a)
    return u, v / step, a / step**2


def _derivatives(points: Array) -> Array:
    """Return the weights of values at points in the first two derivatives at 0, (2, points)."""
    wanted = np.zeros((len(points), 2))
    for order in (1, 2):
        wanted[order:, order - 1][:1] = order
    return np.linalg.solve(np.vander(points, increasing=True).T, wanted).T


def _interpolation(points: Array, others: Array) -> Array:
    """Return the weights of values at points in those at other points, (others, points)."""
    moments = np.vander(others, len(points), increasing=True).T
    return np.linalg.solve(np.vander(points, increasing=True).T, moments).T
