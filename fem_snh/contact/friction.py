"""Coulomb friction on an obstacle, with the normal force and the tangent plane lagged."""

from __future__ import annotations

from typing import Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.geometry.motions import MovingShape
from fem_snh.terms.settling import relative

Array = npt.NDArray[Any]

#: Rounding of the yield limit: a point that slid is at the limit when its slip is kept.
_YIELD = 1 - 1e-9
#: Changes of the lagged pressures that decrease by less than this factor are taken in part ...
_SLOW = 0.5
#: ... of at least this share.
_LEAST_SHARE = 1 / 32


class ContactPoints(NamedTuple):
    """The quadrature points of m facets of which each has a point in contact.

    Attributes
    ----------
    which : (m,) int
        The facets.
    gap : (m, points)
        Signed distance from the obstacle [m].
    pressure : (m, points)
        Contact force per reference area [Pa], 0 without contact.
    normal : (m, points, 3)
        Gradient of the gap: the obstacle's normal, shorter than 1 near the seams of a
        `fem_snh.geometry.shapes.SmoothUnion`.
    curvature : (m, points, 3, 3)
        Hessian of the gap [1/m].
    stiffness : (m, points)
        Minus the derivative of the pressure by the gap [Pa/m].
    energy : (m, points)
        Minus the integral of the pressure over the gap [J/m^2].
    """

    which: Array
    gap: Array
    pressure: Array
    normal: Array
    curvature: Array
    stiffness: Array
    energy: Array

    @property
    def normal_forces(self) -> tuple[Array, Array]:
        """Normal forces per reference area [Pa], and unit normals."""
        length = np.linalg.norm(self.normal, axis=2)
        unit = self.normal / np.where(length > 0, length, 1.0)[..., None]
        return self.pressure * length, unit


class Friction:
    r"""Elastic sticking and sliding of the quadrature points of a surface.

    The tangential displacement s relative to the obstacle has an elastic part, which is kept from
    step to step, so that a body at rest does not creep:

    .. math:: s = (I - n n^T)\left(s_n + x_q(u) - x_q(u_n) - d\right)

    d is the displacement of the obstacle's material point at :math:`x_q(u_n)` since the start of
    the step. With the lagged contact pressure :math:`\ell` and normal n, the energy is the
    Moreau-Yosida regularisation of :math:`\mu \ell |s|` with the tangential stiffness k_t:

    .. math:: \psi(s) = \begin{cases} \frac{k_t}{2} |s|^2 & k_t |s| \le \mu \ell \\
        \mu \ell |s| - \frac{(\mu \ell)^2}{2 k_t} & \text{otherwise} \end{cases}

    Its Hessian is positive semidefinite.

    Parameters
    ----------
    surface : SurfaceQuadrature
        The surface of the body.
    obstacle : MovingShape
        The obstacle.
    coefficient : float
        Coulomb's coefficient mu.
    stiffness : (facets,)
        Tangential stiffness k_t [Pa/m].

    Attributes
    ----------
    pressure : (facets, points)
        The lagged contact pressure l [Pa].
    normal, slip : (facets, points, 3)
        The lagged normal n, and the elastic part s_n [m] at the start of the step.
    """

    def __init__(
        self,
        surface: SurfaceQuadrature,
        obstacle: MovingShape,
        coefficient: float,
        stiffness: Array,
    ) -> None:
        self._surface, self._obstacle = surface, obstacle
        self._mu, self._stiffness = coefficient, stiffness
        self.pressure: Array = np.zeros(surface.weights.shape)
        self.normal, self.slip = (np.zeros(surface.X.shape) for _ in range(2))
        self._start: Array = np.zeros((surface.num_nodes, 3))
        #: The last change of the lagged pressures and its norm [N], and the share of it taken.
        self._difference, self._change, self._share = np.zeros_like(self.pressure), np.inf, 1.0
        self._loads = 0.0, 0.0
        self._select()

    def begin_step(self, u: Array, load: float, at: ContactPoints) -> None:
        """Start a step at nodal displacements ``u`` (nodes, 3) and a load, with points ``at``."""
        self._start, self._loads = u.copy(), (load, load)
        self._difference, self._change, self._share = np.zeros_like(self.pressure), np.inf, 1.0
        self.lag(at)
        self.slip[self.pressure == 0] = 0.0

    def scale_stiffness(self, factor: float) -> None:
        """Multiply the tangential stiffness; the stress of what sticks remains."""
        self._stiffness = factor * self._stiffness
        self.slip /= factor

    def set_load(self, load: float) -> None:
        """Set the load at the end of the step."""
        self._loads = self._loads[0], load
        self._select()

    def lag(self, at: ContactPoints) -> None:
        """Set the lagged pressure and normal to those of the points in contact."""
        self.pressure[:] = 0.0
        pressure, unit = at.normal_forces
        self.pressure[at.which] = pressure
        touching = pressure > 0
        normal = self.normal[at.which]
        normal[touching] = unit[touching]
        self.normal[at.which] = normal
        self._select()

    def settle(self, at: ContactPoints, comm: MPI.Comm, tolerance: float) -> float:
        r"""Lag the pressures after a solve; return their change in ``tolerance``. Collective.

        The change is :math:`\sum_q w_q |\Delta \ell_q|` in the normal force; pressures that
        change by less than the tolerance of it stay. Where friction presses the body on the
        obstacle or lifts it off, new pressures alternate around the solution: if the change does
        not decrease by half, a share of it is lagged, by Aitken's formula
        (Küttler & Wall 2008, eq. 44).
        """
        new = np.zeros_like(self.pressure)
        new[at.which] = at.normal_forces[0]
        d = new - self.pressure
        turn = d - self._difference
        products = (np.abs(d), new, self._difference * turn, turn * turn)
        sums = [float((self._surface.weights * product).sum()) for product in products]
        change, force, along, square = comm.allreduce(np.array(sums))
        ratio = relative(change, force, tolerance)
        if ratio <= 1:
            return ratio
        if change > _SLOW * self._change and along < 0:  # else they grow in the same direction
            self._share = min(1.0, max(_LEAST_SHARE, -self._share * along / square))
        self._difference, self._change = d, change
        lagged = self.pressure + self._share * d
        self.lag(at)
        self.pressure[:] = lagged
        self._select()
        return ratio

    def keep(self, u: Array) -> None:
        """Keep the elastic part of the slip, at the end of a step."""
        forces = self._forces(self._trial(u))
        self.slip[:] = 0.0
        self.slip[self._which] = forces / self._stiffness[self._which, None, None]
        self._start, self._loads = u.copy(), (self._loads[1], self._loads[1])
        self._select()

    def energy(self, u: Array) -> float:
        """Return the energy of this rank's facets [J]."""
        slip, k = self._trial(u), self._stiffness[self._which, None]
        length = np.linalg.norm(slip, axis=2)
        stress = np.minimum(k * length, self._limit)
        energies = stress * (length - 0.5 * stress / k)
        return float((self._weights * energies).sum())

    def weighted_forces(self, u: Array) -> tuple[Array, Array]:
        """Return facets (m,), and the forces on the body at their points (m, points, 3) [N]."""
        return self._which, -self._weights[..., None] * self._forces(self._trial(u))

    def dissipated(self, u: Array, end_weight: float) -> float:
        r"""Return the energy [J] that sliding has dissipated in a step, before `keep`.

        .. math:: \sum_q w_q \left[w\, t_1 + (1 - w)\, t_0\right] \cdot (s - t_1 / k_t)

        with the frictional stresses t at the start and the end of the step, the weight w of the
        latter (1 where the step has them as their mean), and the plastic part
        :math:`s - t_1 / k_t` of the slip.
        """
        k, slip = self._stiffness[self._which, None, None], self._trial(u)
        forces = self._forces(slip)
        mean = end_weight * forces + (1 - end_weight) * k * self.slip[self._which]
        plastic = slip - forces / k
        return float((self._weights[..., None] * mean * plastic).sum())

    def matrices(self, u: Array) -> tuple[Array, Array]:
        """Return cells and their matrices [N/m]."""
        slip, k = self._trial(u), self._stiffness[self._which, None]
        length, limit = np.linalg.norm(slip, axis=2), self._limit
        sticks = k * length <= limit
        normal = self.normal[self._which]
        tangent = np.eye(3) - normal[..., :, None] * normal[..., None, :]
        direction = slip / np.where(length > 0, length, 1.0)[..., None]
        across = tangent - direction[..., :, None] * direction[..., None, :]
        sliding = limit / np.where(sticks, np.inf, length)
        hessian = np.where(sticks, k, 0.0)[..., None, None] * tangent
        hessian += sliding[..., None, None] * across
        # Where nothing is lagged the limit is zero, and a point at rest would seem to stick.
        hessian *= np.where(limit > 0, self._weights, 0.0)[..., None, None]
        cells = self._surface.cells[self._which]
        return cells, self._surface.cell_matrices(hessian, self._which)

    def sliding(self, u: Array) -> int:
        """Return how many of this rank's points slide."""
        length = np.linalg.norm(self._trial(u), axis=2)
        limit = self._limit
        stress = self._stiffness[self._which, None] * length
        return int(((limit > 0) & (stress > _YIELD * limit)).sum())

    def _select(self) -> None:
        """Select the facets with a lagged pressure, and set what is constant in a solve."""
        surface = self._surface
        self._which = which = np.flatnonzero(self.pressure.any(axis=1))
        self._weights = surface.weights[which]
        self._limit = self._mu * self.pressure[which]
        x = surface.positions(self._start, which).reshape(-1, 3)
        moved = self._obstacle.displacement(x, *self._loads)
        self._offset = self.slip[which] - moved.reshape(*self._limit.shape, 3)

    def _trial(self, u: Array) -> Array:
        """Return the tangential displacement s, (m, points, 3) [m]."""
        s = self._offset + self._surface.displacements(u - self._start, self._which)
        normal = self.normal[self._which]
        return np.asarray(s - (s * normal).sum(axis=2, keepdims=True) * normal)

    def _forces(self, slip: Array) -> Array:
        """Return the derivative of the energy density by s, (m, points, 3) [Pa]."""
        k = self._stiffness[self._which, None]
        length = np.linalg.norm(slip, axis=2)
        sticks = k * length <= self._limit
        factor = np.where(sticks, k, self._limit / np.where(sticks, np.inf, length))
        return np.asarray(factor[..., None] * slip)
