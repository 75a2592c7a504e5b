"""Contact with an obstacle as a mean over a step in time, which gives a body no energy.

Newmark's method has it: see `fem_snh.terms.history.MeanForceTerm`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.geometry.motions import MovingShape

Array = npt.NDArray[Any]

#: Depths in the gap before, at the beginning of contact, below which a series has more digits, and
#: above which the gap is none.
_SHALLOW, _DEEP = 1e-2, 1e12
#: Ways relative to the obstacle, in sizes of a facet, in which its surface is flat: rounding of the
#: gaps is above what a mean normal then has to correct.
_FLAT = 1e-8


class MeanContact:
    r"""The contact of a surface with an obstacle as a mean over a step. Not collective.

    The force has the pressure of `mean_pressure` and the normal

    .. math:: \bar n = \tfrac12 (n_0 + n_1)
        + \frac{g_1 - g_0 - \frac12 (n_0 + n_1) \cdot y}{|y|^2}\, y ,
        \qquad \bar n \cdot y = g_1 - g_0

    with the displacement y of a point relative to the obstacle (Gonzalez 1996): it does the work
    that the energy of contact loses, and is of second order where the normal turns. It is no
    gradient. The energy has the force along the normal at the step's end; the rest, ``turn``, is
    lagged, and zero at a plane that does not turn.

    Parameters
    ----------
    surface : SurfaceQuadrature
        The surface of the body.
    obstacle : MovingShape
        The obstacle.

    Attributes
    ----------
    u : (nodes, 3)
        Nodal displacements at the step's start [m].
    load : float
        The load at the step's start.
    which : (m,) int
        The facets that touch at the step's start.
    turn : (facets, points, 3)
        The lagged force per reference area [Pa].
    """

    def __init__(self, surface: SurfaceQuadrature, obstacle: MovingShape) -> None:
        self._surface, self._obstacle = surface, obstacle
        self.turn: Array = np.zeros(surface.X.shape)
        self.begin(np.zeros((surface.num_nodes, 3)), 0.0, np.empty(0, int))

    def begin(self, u: Array, load: float, which: Array) -> None:
        """Begin a step at nodal displacements (nodes, 3) and a load, where facets touch."""
        self.u, self.load, self.which = u.copy(), load, which
        self._start: tuple[Array, Array, Array, Array] | None = None
        self._set_turn(which, 0.0)

    def gaps(self, near: Array) -> Array:
        """Return the gaps of facets at the step's start [m], (m, points)."""
        return self._at_start(near)[2]

    def displacement(self, near: Array, x: Array, load: float) -> Array:
        r"""Return the displacement of the obstacle's material points in the step [m], as x.

        .. math:: \tfrac12 \left[d_{0 \to 1}(x_0) - d_{1 \to 0}(x_1)\right]

        Parameters
        ----------
        near : (m,) int
            The facets.
        x : (m, points, 3)
            Positions of their points at the step's end [m].
        load : float
            The load there.
        """
        if self._obstacle.motion is None:
            return np.zeros_like(x)
        before = self._at_start(near)[1].reshape(-1, 3)
        forth = self._obstacle.displacement(before, self.load, load)
        back = self._obstacle.displacement(x.reshape(-1, 3), load, self.load)
        return np.asarray((forth - back).reshape(x.shape) / 2)

    def normals(self, near: Array, x: Array, gap: Array, normal: Array, load: float) -> Array:
        """Return the mean normals from positions, gaps, normals and load at the step's end."""
        _, before, old_gap, old_normal = self._at_start(near)
        mean = (old_normal + normal) / 2
        way = x - before - self.displacement(near, x, load)
        square = (way**2).sum(axis=2)
        lacking = gap - old_gap - (mean * way).sum(axis=2)
        moved = square > (_FLAT * self._surface.sizes[near, None]) ** 2
        factor = np.where(moved, lacking, 0.0) / np.where(moved, square, 1.0)
        return np.asarray(mean + factor[..., None] * way)

    def lag(self, near: Array, turn: Array) -> float:
        """Set ``turn`` (m, points, 3) of facets; return the sum of its change [N]."""
        before = self.turn.copy()
        self._set_turn(near, turn)
        change = np.linalg.norm(self.turn - before, axis=2)
        return float((self._surface.weights * change).sum())

    def turn_energy(self, u: Array) -> float:
        """Return the energy of ``turn`` at nodal displacements (nodes, 3) [J]."""
        moved = self._surface.displacements(u - self.u, self._turned)
        return -float((self._turn_forces * moved).sum())

    def add_turn(self, r: Array, weight: float) -> None:
        """Add its derivative [N], times a weight, to nodal vectors (nodes, 3)."""
        if len(self._turned):
            self._surface.add_vectors(-weight * self._turn_forces, self._turned, r)

    def _set_turn(self, near: Array, turn: Array | float) -> None:
        """Set ``turn`` of facets; that of others is zero."""
        self.turn[:] = 0.0
        self.turn[near] = turn
        self._turned = np.flatnonzero(self.turn.any(axis=(1, 2)))
        weights = self._surface.weights[self._turned]
        self._turn_forces = weights[..., None] * self.turn[self._turned]

    def _at_start(self, near: Array) -> tuple[Array, Array, Array, Array]:
        """Return facets, and positions, gaps and normals of their points at the step's start."""
        if self._start is None or not np.array_equal(self._start[0], near):
            x = self._surface.positions(self.u, near)
            gap, normal, _ = self._obstacle.evaluate(x.reshape(-1, 3), self.load)
            self._start = near, x, gap.reshape(x.shape[:2]), normal.reshape(x.shape)
        return self._start


class MeanPressure(NamedTuple):
    """The pressure of `mean_pressure`.

    Attributes
    ----------
    energy : array
        Minus the integral of the pressure over the gap at the step's end [J/m^2].
    pressure : array
        The pressure [Pa].
    stiffness : array
        Minus its derivative by the gap [Pa/m].
    """

    energy: Array
    pressure: Array
    stiffness: Array


def mean_pressure(k: Array, start: Array, end: Array) -> MeanPressure:
    r"""Return the pressure of a penalty in a step that does the work that its energy loses.

    .. math:: \bar p = \frac{p_1^2 - p_0^2}{2 k (g_0 - g_1)}

    with the pressures p at the start and the end of the step (Hauret & Le Tallec 2006). It is their
    mean where a point is in contact at both, and less where contact begins or ends.

    Parameters
    ----------
    k : array
        Penalty stiffness [Pa/m].
    start, end : array
        Gaps at the start and the end of the step [m].
    """
    p0, p1 = (np.maximum(-k * gap, 0.0) for gap in (start, end))
    both, opens, closes = (p0 > 0) & (p1 > 0), (p0 > 0) & (p1 == 0), (p0 == 0) & (p1 > 0)
    change = end - start
    # Where contact ends, the distance in p0 / k; where it begins, the depth in the gap before.
    ratio = np.where(opens, k * change, 1.0) / np.where(opens, p0, 1.0)
    depth = np.where(closes, p1 / k, 0.0)
    r = depth / np.where(closes, np.maximum(start, depth / _DEEP), 1.0)
    series = r / 3 - r**2 / 4 + r**3 / 5 - r**4 / 6 + r**5 / 7
    large = np.where(r < _SHALLOW, 1.0, r)
    begun = np.where(r < _SHALLOW, series, 0.5 - 1 / large + np.log1p(large) / large**2)
    closing = k / 2 * depth**2 * begun, p1 / 2 * r / (1 + r), k / 2 * r * (r + 2) / (1 + r) ** 2
    opening = -(p0**2) / (2 * k) * np.log(ratio), p0 / (2 * ratio), k / (2 * ratio**2)
    staying = p1**2 / (4 * k) + p0 * (p0 / k - change) / 2, (p0 + p1) / 2, k / 2
    cases = zip(staying, opening, closing, strict=True)
    return MeanPressure(*(np.where(both, a, np.where(opens, b, c)) for a, b, c in cases))
