"""Contact laws: penalty, augmented Lagrangian, their means over a time step, Coulomb friction."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

from mpi4py import MPI

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.regions import Region
from fem_snh.contact.facet_loops import YIELD, FrictionAt, response, same
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.errors import BadInput
from fem_snh.geometry.motions import MovingShape
from fem_snh.mesh.mesh import cell_volumes
from fem_snh.terms.history import LaggedChange, largest_change, relative

if TYPE_CHECKING:
    from fem_snh.contact.body_contact import BodyPair
    from fem_snh.contact.obstacle_contact import RigidContact


#: Default tolerance of the gap, relative to the height of the cell at the surface.
TOLERANCE = 1e-3
#: With the default tolerance, augmentations also go on until the integral of the pressures'
#: changes, k ``|g|``, is below this fraction of the force: under a small load the gap is within its
#: tolerance without any augmentation. The error of the force is then smaller by E/(k h) <= 0.1.
FORCE_TOLERANCE = 0.02
#: If the gap is below this fraction of its tolerance, the change of forces does not matter: with
#: the default stiffness pressures are 1e-5 E, as of surfaces that just part, and may be noise of
#: Newton's method.
_UNSEEN = 1e-3
#: An augmentation that leaves more than the fraction _SLOW of the gap multiplies the stiffness by
#: _GROWTH (Nocedal & Wright 2006, framework 17.3), up to _LARGEST times the default stiffness.
#: Multipliers at more points than a facet can follow need it: without growth, a ball of 3 cells
#: that bounces stops after 50 augmentations, with it a step takes about 20 Newton iterations.
_SLOW, _GROWTH, _LARGEST = 0.25, 4.0, 1e4
#: Default penalty stiffness, in E over the height of the cell at the facet: where the contact
#: pressure is E/10 the penetration is a hundredth of the height.
#: ``python -m benchmarks hertz --factors 0.1,1,10,100`` measures penetration and cost.
FACTOR = 10.0
#: A mean derivative is not corrected for a displacement in a step below this, in sizes of a facet:
#: the rounding errors of the gaps are larger.
_AT_REST = 1e-8
#: Height of a cell over a facet, relative to the cell's volume over the facet's area.
_HEIGHT = {"tetrahedron": 3.0, "hexahedron": 1.0, "triangle": 2.0, "quadrilateral": 1.0}


class Response(NamedTuple):
    """Energy, pressure and stiffness at a gap, all per reference area and of one shape.

    Attributes
    ----------
    energy : array
        Minus the integral of the pressure over the gap [J/m^2].
    pressure : array
        The pressure [Pa], positive in contact.
    stiffness : array
        Minus the derivative of the pressure by the gap [Pa/m].
    """

    energy: Array
    pressure: Array
    stiffness: Array


def mean_derivative(mean: Array, change: Array, way: Array, size: Array | float) -> Array:
    r"""Return the mean derivatives of gaps over a step, whose product with y is the gap's change.

    With the derivatives :math:`g'_0` and :math:`g'_1` at the step's start and end, and the
    displacement y in the step (Gonzalez 1996):

    .. math:: \bar g' = \tfrac12 (g'_0 + g'_1)
        + \frac{g_1 - g_0 - \frac12 (g'_0 + g'_1) \cdot y}{|y|^2}\, y ,
        \qquad \bar g' \cdot y = g_1 - g_0

    Parameters
    ----------
    mean : (..., k)
        The means :math:`(g'_0 + g'_1)/2`; the result has their shape.
    change : (...)
        The changes :math:`g_1 - g_0` of the gaps [m].
    way : (..., k)
        The displacements y [m].
    size : (...)
        The sizes of the facets [m]; for tiny :math:`|y|` beside them the result is ``mean``.
    """
    square = (way**2).sum(axis=-1)
    moves = square > (_AT_REST * size) ** 2
    lacking = np.where(moves, change - (mean * way).sum(axis=-1), 0.0)
    return np.asarray(mean + (lacking / np.where(moves, square, 1.0))[..., None] * way)


class ContactLaw:
    r"""The normal pressure at quadrature points, by a penalty or an augmented Lagrangian.

    With the gap g of a point (negative: penetration), its weight :math:`w_q`, the stiffness k and
    the multiplier :math:`\ell`, which is zero with a penalty (Wriggers 2006, section 6.3):

    .. math:: E = \sum_q \frac{w_q}{2 k} \left(p^2 - \ell^2\right), \qquad
        p = \langle \ell - k g \rangle = \max(\ell - k g, 0)

    An augmentation sets the multipliers to the pressures. During a step the stiffness increases
    while augmentations reduce the gap slowly. The next step starts with the given stiffness, or
    with the increased stiffness up to the default: with a far smaller stiffness the multipliers are
    a dead load, under which a compressed body may have no stable equilibrium.

    ``rows`` are indices along the first axis of ``weights``; gaps [m] and pressures [Pa] have the
    shape of ``weights[rows]``.

    Parameters
    ----------
    pair : RigidContact or BodyPair
        Has the method, the given stiffness and the tolerance.
    what : str
        The kind of contact, for messages.
    weights : array
        Quadrature weights in the reference configuration [m^2].
    default : array
        The default stiffness [Pa/m], broadcastable to the shape of ``weights``.
    height : array or float
        The height of the cells at the points [m].
    share : float
        Fraction of the stiffness at these points: 0.5 if the other surface has as much.
    comm : MPI.Comm
        The ranks over which the points are distributed. Default: each rank has all points.

    Attributes
    ----------
    multipliers : array
        The multipliers :math:`\ell` [Pa], of the shape of ``weights``.
    stiffness : array
        The present stiffness [Pa/m], of the same shape.
    kept : array
        The multipliers at the end of the last accepted step [Pa].
    kept_factor : float
        The stiffness over the given stiffness then.
    version : int
        Increases whenever multipliers or stiffness are set.
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
        unknown = comm.allreduce(bool(np.isnan(default).any()), op=MPI.LOR)
        if pair.stiffness is None and unknown:
            raise BadInput(
                f"{self._name}: stiffness: expected a value [Pa/m]: cells without a material have "
                "no default"
            )
        k = default if pair.stiffness is None else np.full_like(default, pair.stiffness)
        self._given = np.broadcast_to(share * k, weights.shape)
        self.multipliers, self.kept = np.zeros_like(weights), np.zeros_like(weights)
        # Without a default the given stiffness takes its place.
        ratios = np.ones(1) if unknown else default / k
        ratio = comm.allreduce(ratios.max(initial=0.0), op=MPI.MAX)
        self._default, self._largest = max(ratio, 1.0), max(_LARGEST * ratio, 1.0)
        self.kept_factor, self.version = 1.0, 0
        self.begin_step()

    def begin_step(self) -> None:
        """Reset the multipliers and the stiffness to those of the last accepted step."""
        self._gap = math.inf
        self._set(self.kept_factor, slice(None), self.kept)

    def end_step(self, rows: Array, gap: Array, pressure: Array) -> None:
        """Store the multipliers and the factor of the stiffness for the next step.

        If the factor must decrease, the multipliers at ``rows`` increase to keep the pressure.
        """
        factor = min(self._factor, self._default)
        if factor < self._factor:
            taken = np.where(pressure > 0, pressure + factor * self._given[rows] * gap, 0.0)
            self._set(factor, rows, taken)
        self.kept[:], self.kept_factor = self.multipliers, factor

    def scale_penalty(self, factor: float) -> bool:
        """Multiply the penalty stiffness by ``factor`` and return True.

        With an augmented Lagrangian do nothing and return False.
        """
        if self.augmented:
            return False
        self._given = factor * self._given
        self._set(self._factor, slice(None), self.kept)
        return True

    def trial(self, rows: Array, gap: Array) -> Array:
        """Return l - k g [Pa], whose positive part is the pressure."""
        return np.asarray(self.multipliers[rows] - self.stiffness[rows] * gap)

    def response(self, rows: Array, gap: Array, start: Array | None = None) -> Response:
        """Return the response to gaps, or of a penalty its mean over a step from gaps ``start``.

        With an augmented Lagrangian ``start`` is ignored: the multipliers are mean pressures.
        """
        start = None if self.augmented else start
        return Response(*response(rows, self.stiffness, self.multipliers, gap, start))

    def energy(self, rows: Array, energy: Array) -> float:
        """Return this rank's energy [J] from energies per area at ``rows`` [J/m^2].

        Points in other rows have no pressure.
        """
        acting = float((self.weights[rows] * energy).sum())
        return acting - self._constant

    def settle(self, rows: Array, gap: Array, pressure: Array) -> list[LaggedChange]:
        """Augment if the gap or the force has not settled; return both changes. Collective.

        The gap's is the largest ``|gap|`` in contact over the tolerance. With a penalty there are
        no changes.
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
        """Return columns (points, 1): the kept multipliers [Pa], and the factor, repeated."""
        column = self.kept.reshape(-1, 1)
        return column, np.full_like(column, self.kept_factor)

    def set_history(self, kept: Array, factors: Array, comm: MPI.Comm) -> None:
        """Set what `begin_step` resets to; the factor is the largest of all ranks'. Collective."""
        self.kept[:] = kept.reshape(self.kept.shape)
        self.kept_factor = comm.allreduce(float(factors.max(initial=1.0)), op=MPI.MAX)

    def _set(self, factor: float, rows: Array | slice, multipliers: Array) -> None:
        """Set the factor of the given stiffness, and multipliers at ``rows``, zero elsewhere."""
        self._factor, self.stiffness = factor, factor * self._given
        values = np.zeros_like(self.multipliers)
        values[rows] = multipliers
        self.multipliers[:] = values
        #: The sum of w l^2 / 2 k [J], which the energy lacks.
        self._constant = float((self.weights * values**2 / (2 * self.stiffness)).sum())
        self.version += 1


def cell_heights(surface: SurfaceQuadrature) -> Array:
    """Return the height of the cell over each facet [m], (facets,)."""
    domain = surface.V.mesh
    factor = _HEIGHT[_dolfinx.cell_name(domain)]
    return np.asarray(factor * cell_volumes(domain)[surface.cells] / surface.areas)


def surface_mean(surface: SurfaceQuadrature, values: Array) -> float:
    """Return the mean of the facets' values (facets,), weighted by area. Collective."""
    areas = surface.weights.sum(axis=1)
    total = surface.V.mesh.comm.allreduce(np.array([areas @ values, areas.sum()]))
    return float(total[0] / total[1])


def cell_moduli(V: FunctionSpace, regions: Sequence[Region]) -> Array:
    """Return Young's modulus of each owned cell, (cells,) [Pa]; NaN without a material."""
    moduli = np.full(_dolfinx.num_owned(V.mesh), np.nan)
    for region in regions:
        moduli[region.cells] = region.material.numbers.E
    return moduli


def default_stiffness(surface: SurfaceQuadrature, regions: Sequence[Region]) -> Array:
    """Return the default penalty stiffness of each facet, `FACTOR` E/height, (facets,) [Pa/m]."""
    moduli = cell_moduli(surface.V, regions)[surface.cells]
    return np.asarray(FACTOR * moduli / cell_heights(surface))


#: If a change of the lagged pressures is more than this times the last one, they get a share of it.
_SLOWLY = 0.5
#: The least share.
_LEAST_SHARE = 1 / 32


class ContactPoints(NamedTuple):
    """The quadrature points of m facets, which include all with a point in contact.

    Attributes
    ----------
    which : (m,) int
        The facets.
    gap : (m, points)
        Signed distance from the obstacle [m], negative inside.
    pressure : (m, points)
        Contact force per reference area [Pa], 0 without contact; negative only in a linearised
        step.
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
        """Normal forces per reference area (m, points) [Pa], and unit normals (m, points, 3)."""
        length = np.linalg.norm(self.normal, axis=2)
        unit = self.normal / np.where(length > 0, length, 1.0)[..., None]
        return self.pressure * length, unit


class Friction:
    r"""Coulomb friction at the quadrature points of a surface, with elastic sticking.

    The slip s is the tangential displacement relative to the obstacle. Its elastic part
    :math:`s_n` is kept from step to step, so that a body at rest does not creep:

    .. math:: s = (I - n n^T)\left(s_n + x_q(u) - x_q(u_n) - d\right)

    with the displacement :math:`u_n` at the start of the step, and d the displacement since then
    of the obstacle's material point at :math:`x_q(u_n)`. With the lagged contact pressure
    :math:`\ell` and normal n, the energy is the Moreau-Yosida regularisation of
    :math:`\mu \ell |s|` with the tangential stiffness k_t:

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
        The lagged contact pressure :math:`\ell` [Pa].
    normal : (facets, points, 3)
        The lagged unit normal n of the obstacle.
    slip : (facets, points, 3)
        The elastic part :math:`s_n` of the slip at the start of the step [m].
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
        #: The last change of the lagged pressures [Pa], its integral [N], and the share of it that
        #: was lagged.
        self._difference, self._change, self._share = np.zeros_like(self.pressure), np.inf, 1.0
        self._loads = 0.0, 0.0
        self._select()

    def begin_step(self, u: Array, load: float, at: ContactPoints) -> None:
        """Start a step at nodal displacements ``u`` (local nodes, 3) and a load.

        Pressures and normals are lagged from ``at``. The slip becomes 0 where the pressure is 0.
        """
        self._start, self._loads = u.copy(), (load, load)
        self._difference, self._change, self._share = np.zeros_like(self.pressure), np.inf, 1.0
        self.lag(at)
        self.slip[self.pressure == 0] = 0.0

    def scale_stiffness(self, factor: float) -> None:
        """Multiply the tangential stiffness, and divide the slip, so that stresses stay."""
        self._stiffness = factor * self._stiffness
        self.slip /= factor
        self._select()

    def set_load(self, load: float) -> None:
        """Set the load at the end of the step, to which the obstacle moves."""
        self._loads = self._loads[0], load
        self._select()

    def lag(self, at: ContactPoints) -> None:
        """Set lagged pressures and normals from ``at``; without contact pressures are zero."""
        self.pressure[:] = 0.0
        pressure, unit = at.normal_forces
        self.pressure[at.which] = pressure
        touching = pressure > 0
        normal = self.normal[at.which]
        normal[touching] = unit[touching]
        self.normal[at.which] = normal
        self._select()

    def settle(self, at: ContactPoints, comm: MPI.Comm, tolerance: float) -> float:
        r"""Lag the pressures after a solve; return their change over ``tolerance``. Collective.

        The change is :math:`\sum_q w_q |\Delta \ell_q|`, relative to the normal force. Within the
        tolerance, the pressures stay. Where friction presses the body on the obstacle or lifts it
        off, new pressures alternate around the solution: if the change does not decrease by half, a
        share of it is lagged, by Aitken's formula (Küttler & Wall 2008, eq. 44).
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
        """Store the elastic part of the slip, at the end of a step with displacements ``u``."""
        stress = self._evaluate(u)[1]
        self.slip[:] = 0.0
        self.slip[self._which] = stress / self._stiffness[self._which, None, None]
        self._start, self._loads = u.copy(), (self._loads[1], self._loads[1])
        self._select()

    def energy(self, u: Array) -> float:
        """Return the energy of this rank's facets [J]."""
        return self._evaluate(u)[2]

    def weighted_forces(self, u: Array) -> tuple[Array, Array]:
        """Return facets (m,), and frictional forces on the body (m, points, 3) [N]."""
        return self._which, -self._weights[..., None] * self._evaluate(u)[1]

    def dissipated(self, u: Array, end_weight: float) -> float:
        r"""Return the energy [J] that sliding has dissipated in a step; call it before `keep`.

        .. math:: \sum_q w_q \left[w\, t_1 + (1 - w)\, t_0\right] \cdot (s - t_1 / k_t)

        with the frictional stresses :math:`t_0, t_1` at the start and the end of the step, the
        weight w, ``end_weight`` (1 if :math:`t_1` is the step's mean), and the plastic part
        :math:`s - t_1 / k_t` of the slip. The sum is over this rank's points.
        """
        k, (slip, stress, _) = self._stiffness[self._which, None, None], self._evaluate(u)
        mean = end_weight * stress + (1 - end_weight) * k * self.slip[self._which]
        plastic = slip - stress / k
        return float((self._weights[..., None] * mean * plastic).sum())

    def matrices(self, u: Array) -> tuple[Array, Array]:
        """Return cells (m,) and the Hessians (m, n, n) [N/m] of their n displacement dofs."""
        matrices = self._surface.loops.friction_matrices(
            self._which, self._at, self._evaluate(u)[0]
        )
        return self._surface.cells[self._which], matrices

    def sliding(self, u: Array) -> int:
        """Return how many of this rank's points slide."""
        length = np.linalg.norm(self._evaluate(u)[0], axis=2)
        limit = self._at.limit
        stress = self._stiffness[self._which, None] * length
        return int(((limit > 0) & (stress > YIELD * limit)).sum())

    def _select(self) -> None:
        """Select the facets with a lagged pressure; set their limits of stress and offsets of s."""
        surface = self._surface
        self._which = which = np.flatnonzero(self.pressure.any(axis=1)).astype(np.int32)
        self._weights = surface.weights[which]
        x = surface.positions(self._start, which).reshape(-1, 3)
        moved = self._obstacle.displacement(x, *self._loads)
        limit, slip = self._mu * self.pressure[which], self.slip[which]
        offset = slip - moved.reshape(slip.shape)
        self._at = FrictionAt(self._stiffness, self.normal, limit, offset)
        self._evaluated: tuple[Array, tuple[Array, Array, float]] | None = None

    def _evaluate(self, u: Array) -> tuple[Array, Array, float]:
        """Return the slip s [m], the derivative of the energy by s [Pa], and the energy [J].

        Both arrays are (m, points, 3); the last result is cached.
        """
        if self._evaluated is None or not same(self._evaluated[0], u):
            moved = u - self._start
            self._evaluated = u.copy(), self._surface.loops.friction(self._which, self._at, moved)
        return self._evaluated[1]
