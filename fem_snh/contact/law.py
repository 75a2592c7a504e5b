"""Contact's laws: penalty and augmented Lagrangian, at a state and as means; Coulomb friction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.assembly.regions import Region
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.geometry.motions import MovingShape
from fem_snh.mesh.mesh import cell_volumes
from fem_snh.terms.history import LaggedChange, largest_change, relative

if TYPE_CHECKING:
    from fem_snh.contact.body_contact import BodyPair
    from fem_snh.contact.obstacle_contact import RigidContact


Array = npt.NDArray[Any]

#: Default tolerance of the gap in the height of the cell at the surface.
TOLERANCE = 1e-3
#: With the default tolerance the sum of the pressures' changes by an augmentation, k ``|g|``, is
#: below this part of the force, too: a small load leaves a small gap, without any augmentation.
#: What the force then lacks is smaller by E/(k h), which is a tenth or less.
FORCE_TOLERANCE = 0.02
#: Below this part of the tolerance of the gap forces are not looked at: with the default stiffness
#: pressures of 1e-5 E, as of surfaces that just part, may be noise of Newton's method.
_UNSEEN = 1e-3
#: Augmentations that leave more than this part of the gap increase the stiffness by this factor
#: (Nocedal & Wright 2006, framework 17.3), at most to this multiple of the default stiffness.
#: Multipliers at more points than a facet can follow need it: without, a ball of 3 cells that
#: bounces stops after 50 augmentations, with it a step takes about 20 Newton iterations.
_SLOW, _GROWTH, _LARGEST = 0.25, 4.0, 1e4
#: Penalty stiffness in E over the size of the cell at the facet: where the contact pressure is E/10
#: the penetration is a hundredth of the cell.
#: ``python -m benchmarks hertz --factors 0.1,1,10,100`` measures what it leaves and what it costs.
FACTOR = 10.0
#: Depths in the gap before, at the beginning of contact, below which a series has more digits, and
#: above which the gap is none.
_SHALLOW, _DEEP = 1e-2, 1e12
#: Ways in a step, in sizes of a facet, below which a mean derivative needs no correction: rounding
#: of the gaps is above it.
_AT_REST = 1e-8
#: Height of a cell over a facet, in its volume over the facet's area.
_HEIGHT = {"tetrahedron": 3.0, "hexahedron": 1.0, "triangle": 2.0, "quadrilateral": 1.0}


class Response(NamedTuple):
    """What a gap causes.

    Attributes
    ----------
    energy : array
        Minus the integral of the pressure over the gap [J/m^2].
    pressure : array
        The pressure [Pa].
    stiffness : array
        Minus its derivative by the gap [Pa/m].
    """

    energy: Array
    pressure: Array
    stiffness: Array


def mean_pressure(k: Array, start: Array, end: Array) -> Response:
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
    return Response(*(np.where(both, a, np.where(opens, b, c)) for a, b, c in cases))


def mean_derivative(mean: Array, change: Array, way: Array, size: Array | float) -> Array:
    r"""Return the derivatives of gaps in a step with which forces do the work of contact's energy.

    With the derivatives :math:`g'_0` and :math:`g'_1` at the step's start and end, and the way y
    (Gonzalez 1996):

    .. math:: \bar g' = \tfrac12 (g'_0 + g'_1)
        + \frac{g_1 - g_0 - \frac12 (g'_0 + g'_1) \cdot y}{|y|^2}\, y ,
        \qquad \bar g' \cdot y = g_1 - g_0

    Parameters
    ----------
    mean, way : (..., k)
        The mean of the derivatives, and the ways y [m].
    change : (...)
        The changes of the gaps [m].
    size : (...)
        The sizes of the facets [m].
    """
    square = (way**2).sum(axis=-1)
    moves = square > (_AT_REST * size) ** 2
    lacking = np.where(moves, change - (mean * way).sum(axis=-1), 0.0)
    return np.asarray(mean + (lacking / np.where(moves, square, 1.0))[..., None] * way)


class ContactLaw:
    r"""Normal contact of points, with a penalty or with an augmented Lagrangian.

    With the gap g of the points, their weights w_q, the stiffness k and multipliers :math:`\ell`,
    which are zero with a penalty (Wriggers 2006, section 6.3):

    .. math:: E = \sum_q \frac{w_q}{2 k} \left(p^2 - \ell^2\right), \qquad
        p = \langle \ell - k g \rangle = \max(\ell - k g, 0)

    An augmentation sets the multipliers to the pressures. The stiffness increases in a step while
    they reduce the gap slowly. The next step begins with the given stiffness, or with the increased
    one where that is below the default: with a far smaller one the multipliers are a dead load,
    under which a compressed body may have no stable equilibrium.

    ``rows`` number points along the first axis of the weights; gaps [m] and pressures [Pa] have the
    shape of the weights' rows.

    Parameters
    ----------
    pair : RigidContact or BodyPair
        The choice of a method, a stiffness and a tolerance.
    what : str
        What kind of contact it is, for the reason of a failure.
    weights : array
        Quadrature weights in the reference configuration [m^2].
    default : array
        The default stiffness [Pa/m], of a shape that extends to that of the weights.
    height : array or float
        The height of the cells at the points [m].
    share : float
        The part of the stiffness that these points have.
    comm : MPI.Comm
        The ranks that share the points. Default: each rank has all of them.

    Attributes
    ----------
    multipliers : array
        The multipliers l [Pa].
    stiffness : array
        The present stiffness [Pa/m].
    kept, kept_factor : array, float
        The multipliers and the factor of the given stiffness at the start of a step.
    version : int
        Changes whenever multipliers or stiffness do.
    """

    def __init__(
        self,
        pair: RigidContact | BodyPair,
        what: str,
        weights: Array,
        default: Array,
        height: Array | float,
        share: float = 1.0,
        comm: MPI.Comm = MPI.COMM_SELF,
    ) -> None:
        self.weights, self.augmented = weights, pair.augmented
        self._name, self.comm = f"{what} '{pair.name}'", comm
        self._limits_force = pair.tolerance is None and pair.limits_force
        tolerance = TOLERANCE * height if pair.tolerance is None else pair.tolerance
        self._tolerance = np.broadcast_to(tolerance, weights.shape)
        k = default if pair.stiffness is None else np.full_like(default, pair.stiffness)
        self._given = np.broadcast_to(share * k, weights.shape)
        self.multipliers, self.kept = np.zeros_like(weights), np.zeros_like(weights)
        ratio = comm.allreduce((default / k).max(initial=0.0), op=MPI.MAX)
        self._default, self._largest = max(ratio, 1.0), max(_LARGEST * ratio, 1.0)
        self.kept_factor, self.version = 1.0, 0
        self.begin_step()

    def begin_step(self) -> None:
        """Reset the multipliers and the stiffness to those of the last accepted step."""
        self._gap = math.inf
        self._set(self.kept_factor, slice(None), self.kept)

    def end_step(self, rows: Array, gap: Array, pressure: Array) -> None:
        """Keep the multipliers; they take over the pressure that an increased stiffness has had."""
        factor = min(self._factor, self._default)
        if factor < self._factor:
            taken = np.where(pressure > 0, pressure + factor * self._given[rows] * gap, 0.0)
            self._set(factor, rows, taken)
        self.kept[:], self.kept_factor = self.multipliers, factor

    def scale_penalty(self, factor: float) -> bool:
        """Multiply the given stiffness; return whether it is a penalty's, without multipliers."""
        if self.augmented:
            return False
        self._given = factor * self._given
        self._set(self._factor, slice(None), self.kept)
        return True

    def trial(self, rows: Array, gap: Array) -> Array:
        """Return l - k g, whose positive part is the pressure."""
        return np.asarray(self.multipliers[rows] - self.stiffness[rows] * gap)

    def response(self, rows: Array, gap: Array, start: Array | None = None) -> Response:
        """Return what gaps cause; as the mean over a step, with the gaps at its start.

        Multipliers are means themselves: they leave no compliance, whose energy would be given back
        where contact ends.
        """
        k = self.stiffness[rows]
        if start is not None and not self.augmented:
            return mean_pressure(k, start, gap)
        pressure = np.maximum(self.trial(rows, gap), 0.0)
        return Response(pressure**2 / (2 * k), pressure, k)

    def energy(self, rows: Array, energy: Array) -> float:
        """Return the energy of all points, of which these have an energy per area [J]."""
        acting = float((self.weights[rows] * energy).sum())
        if not self.augmented:
            return acting
        return acting - float((self.weights * self.multipliers**2 / (2 * self.stiffness)).sum())

    def settle(self, rows: Array, gap: Array, pressure: Array) -> list[LaggedChange]:
        """Return the gap and the change of the force; augment if one is too large. Collective.

        With a penalty there are none.
        """
        if not self.augmented:
            return []
        found = (np.abs(gap) / self._tolerance[rows])[pressure > 0]
        error = self.comm.allreduce(float(found.max(initial=0.0)), op=MPI.MAX)
        changes = [LaggedChange(error, f"{self._name}: the gap")]
        if self._limits_force:
            change = self.multipliers.copy()
            change[rows] -= pressure
            sums = (self.weights * np.abs(change)).sum(), (self.weights[rows] * pressure).sum()
            lost, force = self.comm.allreduce(np.array(sums)).tolist()
            ratio = relative(lost, force, FORCE_TOLERANCE)
            what = f"{self._name}: the change of multipliers"
            changes.append(LaggedChange(min(ratio, error / _UNSEEN), what))
        if not largest_change(changes).settled:
            slow = error > _SLOW * self._gap and self._factor < self._largest
            self._set(self._factor * (_GROWTH if slow else 1.0), rows, pressure)
            self._gap = error
        return changes

    def history(self) -> tuple[Array, Array]:
        """Return columns (n, 1) of what is kept at the points: multipliers, and the factor."""
        column = self.kept.reshape(-1, 1)
        return column, np.full_like(column, self.kept_factor)

    def set_history(self, kept: Array, factors: Array, comm: MPI.Comm) -> None:
        """Set what is kept at the points, and the factor from this rank's points. Collective."""
        self.kept[:] = kept.reshape(self.kept.shape)
        self.kept_factor = comm.allreduce(float(factors.max(initial=1.0)), op=MPI.MAX)

    def _set(self, factor: float, rows: Array | slice, multipliers: Array) -> None:
        """Set the factor of the stiffness, and the multipliers: those of other rows are zero."""
        self._factor, self.stiffness = factor, factor * self._given
        values = np.zeros_like(self.multipliers)
        values[rows] = multipliers
        self.multipliers[:] = values
        self.version += 1


def cell_heights(surface: SurfaceQuadrature) -> Array:
    """Return the height of the cell over each facet [m], (facets,)."""
    domain = surface.V.mesh
    factor = _HEIGHT[_dolfinx.cell_name(domain)]
    return np.asarray(factor * cell_volumes(domain)[surface.cells] / surface.areas)


def surface_mean(surface: SurfaceQuadrature, values: Array) -> float:
    """Return the mean over the area of values of the facets. Collective."""
    areas = surface.weights.sum(axis=1)
    total = surface.V.mesh.comm.allreduce(np.array([areas @ values, areas.sum()]))
    return float(total[0] / total[1])


def cell_moduli(V: FunctionSpace, regions: Sequence[Region]) -> Array:
    """Return Young's modulus in each owned cell [Pa]."""
    moduli = np.empty(_dolfinx.num_owned(V.mesh))
    for region in regions:
        moduli[region.cells] = region.material.numbers.E
    return moduli


def default_stiffness(surface: SurfaceQuadrature, regions: Sequence[Region]) -> Array:
    """Return the default penalty stiffness of each facet [Pa/m], (facets,)."""
    moduli = cell_moduli(surface.V, regions)[surface.cells]
    return np.asarray(FACTOR * moduli / cell_heights(surface))


#: Rounding of the yield limit: a point that slid is at the limit when its slip is kept.
_YIELD = 1 - 1e-9
#: Changes of the lagged pressures that decrease by less than this factor are taken in part ...
_SLOWLY = 0.5
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
        if change > _SLOWLY * self._change and along < 0:  # else they grow in the same direction
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
