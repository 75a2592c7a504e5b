"""Contact of a surface with one rigid obstacle: energy, force, Hessian, and the work it does."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.contact.friction import ContactPoints, Friction
from fem_snh.contact.law import ContactLaw
from fem_snh.contact.mean_contact import MeanContact, MeanPressure, mean_pressure
from fem_snh.contact.surface_quadrature import (
    FINE_INTERVALS,
    GRID_INTERVALS,
    DeepestPoint,
    SurfaceQuadrature,
    facet_grid,
    may_be_deep,
)
from fem_snh.geometry.motions import MovingShape
from fem_snh.kernels.cell_matrices import filter_matrices

Array = npt.NDArray[Any]

#: Distance by which nodes may move before the facets are searched again, in mean radii of facets. A
#: larger one costs evaluations at more points, a smaller one more searches.
_MARGIN = 1.0


class NearFacets:
    """The facets with points at or below distance zero, and others that are close to it.

    A signed distance grows by at most the length of a way, so a facet whose centre is at a
    distance above the facet's radius has no point at distance zero. The list stays valid while no
    node moves by more than a margin relative to the obstacle, so that most evaluations only compare
    the nodes' positions.

    Parameters
    ----------
    surface : SurfaceQuadrature
        The facets.
    X : (local nodes, 3)
        Reference coordinates of the displacement's nodes [m].
    distance : callable
        Returns the signed distances (n,) of points (n, 3).
    facets : (n,) int, optional
        Local numbers of the facets that may touch the obstacle. Default: all of the surface.
    material : callable, optional
        Returns the material points of the obstacle that are at points (n, 3). Default: it rests.
    """

    def __init__(
        self,
        surface: SurfaceQuadrature,
        X: Array,
        distance: Callable[[Array], Array],
        facets: Array | None = None,
        material: Callable[[Array], Array] = np.asarray,
    ) -> None:
        chosen = slice(None) if facets is None else np.isin(surface.facets, facets)
        self._indices = np.arange(len(surface))[chosen]
        corners = surface.nodes[chosen]
        self._nodes, nodes = np.unique(corners, return_inverse=True)
        self._corners = nodes.reshape(corners.shape)
        self._X, self._distance, self._material = X[self._nodes], distance, material
        # |x_q - c| <= sum |N_a| max |x_a - c|, as the shape functions sum to 1.
        self._spread = np.abs(surface.basis).sum(axis=1).max()
        radii = self._balls(self._X)[1]
        self._margin = _MARGIN * float(radii.mean()) if len(radii) else 0.0
        self._searched: Array | None = None
        self._found: Array = np.empty(0, int)
        self._valid = 0.0

    def at(self, u: Array) -> Array:
        """Return the indices of facets, sorted (m,).

        Parameters
        ----------
        u : (local nodes, 3)
            Nodal displacements [m], ghosts included.
        """
        x = self._X + u[self._nodes]
        relative = self._material(x)
        if self._searched is not None:
            way = relative - self._searched
            moved = np.einsum("ni,ni->n", way, way).max(initial=0.0)
            if self._spread**2 * moved <= self._valid**2:
                return self._found
        self._searched = relative
        self._found, self._valid = np.empty(0, int), self._gap_of_all(x)
        if self._valid <= self._margin:
            centers, radii = self._balls(x)
            gaps = self._distance(centers) - radii
            self._found = self._indices[gaps <= self._margin]
            self._valid = max(self._margin, gaps.min(initial=np.inf))
        return self._found

    def _gap_of_all(self, x: Array) -> float:
        """Return the distance of a ball that contains all points, a bound of theirs."""
        if not len(x):
            return np.inf
        low, high = x.min(axis=0), x.max(axis=0)
        radius = self._spread * np.linalg.norm(high - low) / 2
        return float(self._distance((low + high)[None] / 2)[0] - radius)

    def _balls(self, x: Array) -> tuple[Array, Array]:
        """Return centres (facets, 3) and radii (facets,) of balls that contain the points."""
        corners = x[self._corners]
        centers = corners.mean(axis=1)
        ways = corners - centers[:, None]
        return centers, self._spread * np.sqrt(np.einsum("fki,fki->fk", ways, ways).max(axis=1))


class PointForces(NamedTuple):
    """Forces of an obstacle on a body.

    Attributes
    ----------
    x : (n, 3)
        Their points of action [m].
    forces : (n, 3)
        The forces [N].
    """

    x: Array
    forces: Array


class ObstaclePair:
    r"""A surface and an obstacle: the energies of `ContactLaw` and `Friction`. Not collective.

    Of the former the derivatives are

    .. math:: \frac{\partial E}{\partial x_q} = - w_q p \nabla g, \qquad
        \frac{\partial^2 E}{\partial x_q^2} = w_q \left(k \nabla g \nabla g^T - p \nabla^2 g\right)
        \quad (p > 0)

    As :math:`|\nabla g| = 1`, the normal is an eigenvector of both parts: filtering the second one
    filters their sum.

    Parameters
    ----------
    surface : SurfaceQuadrature
        The surface of the body.
    X : (local nodes, 3)
        Reference coordinates of the displacement's nodes [m].
    obstacle : MovingShape
        The obstacle.
    law : ContactLaw
        The law of the quadrature points, (facets, points).
    friction : Friction, optional
        The friction at these points.
    facets : (n,) int, optional
        Local numbers of the facets that may touch the obstacle. Default: all of the surface.

    Attributes
    ----------
    surface, obstacle, law, friction
        The parameters.
    load : float
        The load at which the obstacle is.
    mean_weight : float or None
        Weight of the energy of a step's mean forces, in place of that of the present ones: see
        `fem_snh.terms.history.MeanForceTerm`.
    linearised : bool
        Whether steps are linearised at their start. Points in contact there then stay on the linear
        branch :math:`p = \ell - k g` in the linearisation: where an obstacle recedes by more than
        its penetration, the body follows it instead of expanding freely for a step.
    """

    def __init__(
        self,
        surface: SurfaceQuadrature,
        X: Array,
        obstacle: MovingShape,
        law: ContactLaw,
        friction: Friction | None = None,
        facets: Array | None = None,
    ) -> None:
        self.surface, self.obstacle, self.law, self.friction = surface, obstacle, law, friction
        self.load, self.linearised = 0.0, False
        self.mean_weight: float | None = None
        self._near = NearFacets(surface, X, self.distance, facets, self._material)
        #: Displacement at the start of a linearised step; its facets and points in contact.
        self._start: tuple[Array, Array, Array] | None = None
        #: The load at the start of the step, and the forces of an obstacle that moves.
        self._before: tuple[float, PointForces | None] = 0.0, None
        self._mean_contact = MeanContact(surface, obstacle)
        #: The last displacement, and what `_evaluate` returned for it.
        self._gaps: tuple[Array, tuple[Array, Array, Array, Array]] | None = None
        #: The last ``_gaps`` and version of the law, and what `_mean` returned for them.
        self._means: tuple[Any, int, tuple[ContactPoints, MeanPressure]] | None = None

    def set_load(self, load: float) -> None:
        """Move the obstacle to its position at a load."""
        if load != self.load and self.obstacle.motion is not None:
            self._gaps = None
        self.load = load
        if self.friction:
            self.friction.set_load(load)

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of penalties; return whether there are any.

        That of sticking is one beside multipliers too.
        """
        if self.friction:
            self.friction.scale_stiffness(factor)
        return self.law.scale_penalty(factor) or self.friction is not None

    def begin_step(self, u: Array) -> None:
        """Begin a step at nodal displacements ``u`` (nodes, 3)."""
        self.law.begin_step()
        self._start = None
        if self.linearised:
            at = self.points(u)
            self._start, self._gaps = (u.copy(), at.which, at.pressure > 0), None
        if self.friction:
            self.friction.begin_step(u, self.load, self.points(u))
        self._mean_contact.begin(u, self.load, self.points(u).which)
        moves = self.obstacle.motion is not None
        self._before = self.load, self._forces(u, self.points(u).acting) if moves else None

    def weight_mean_forces(self, weight: float | None) -> None:
        """Set ``mean_weight``."""
        if (weight is None) != (self.mean_weight is None):
            self._gaps = None
        self.mean_weight = weight

    def end_step(self, u: Array) -> None:
        """Accept a step that ends at nodal displacements ``u`` (nodes, 3)."""
        self._start = None
        if self.law.augmented:
            self.law.end_step(*self.points(u)[:3])
        if self.friction:
            self.friction.keep(u)

    def work(self, u: Array, end_weight: float) -> tuple[float, float]:
        """Return the obstacle's work in a step, and what friction dissipated, on this rank [J].

        The arguments are those of `fem_snh.terms.history.WorkingTerm`. The forces of a step that is
        linearised at its start are those of the linearisation; mean forces have no other weight.
        """
        work, (load, before) = 0.0, self._before
        if self.mean_weight is not None:
            end_weight, work = 1.0, self._work_of_means(u)
        elif before is not None:
            after = self._forces(u, self._end_pressure(u))
            for weight, at in ((end_weight, after), (1 - end_weight, before)):
                work += weight * obstacle_work(self.obstacle, at, load, self.load)
        return work, self.friction.dissipated(u, end_weight) if self.friction else 0.0

    def _work_of_means(self, u: Array) -> float:
        """Return the obstacle's work in a step with mean forces [J]."""
        if self.obstacle.motion is None:
            return 0.0
        work = 0.0
        for which, forces in self._weighted_forces(u, self.mean_points(u).acting):
            x = self.surface.positions(u, which)
            moved = self._mean_contact.displacement(which, x, self.load)
            work += float((forces * moved).sum())
        return work

    def _forces(self, u: Array, acting: tuple[Array, Array, Array]) -> PointForces:
        """Return the forces of contact and friction on this rank's facets."""
        found = self._weighted_forces(u, acting)
        x = [self.surface.positions(u, which).reshape(-1, 3) for which, _ in found]
        forces = [f.reshape(-1, 3) for _, f in found]
        return PointForces(np.concatenate(x), np.concatenate(forces))

    def _weighted_forces(
        self, u: Array, acting: tuple[Array, Array, Array]
    ) -> list[tuple[Array, Array]]:
        """Return facets, and the forces (m, points, 3) at their points [N]: contact, friction."""
        which, pressure, normal = acting
        found = [(which, (self.surface.weights[which] * pressure)[..., None] * normal)]
        if self.friction:
            found.append(self.friction.weighted_forces(u))
        return found

    def distance(self, x: Array) -> Array:
        """Return the signed distance of points (n, 3) from the obstacle [m]."""
        return np.asarray(self.obstacle.evaluate(x, self.load)[0])

    def _material(self, x: Array) -> Array:
        """Return the obstacle's material points that are at points (n, 3)."""
        return self.obstacle.pose(self.load).invert(x) if self.obstacle.motion else x

    def points(self, u: Array) -> ContactPoints:
        """Return the points of facets in contact; ``u`` are nodal displacements (nodes, 3)."""
        near, gap, normal, curvature = self._evaluate(u)
        trial = self.law.trial(near, gap)
        pressure = np.maximum(trial, 0.0)
        if self._start and np.array_equal(self._start[0], u):
            rows = np.searchsorted(near, self._start[1])
            pressure[rows] = np.where(self._start[2], trial[rows], pressure[rows])
        touching = (pressure != 0).any(axis=1)
        return ContactPoints(
            near[touching],
            gap[touching],
            pressure[touching],
            normal[touching],
            curvature[touching],
        )

    def points_of_step(self, u: Array) -> ContactPoints:
        """Return the points with the pressures of the step: at its end, or mean ones."""
        if self.mean_weight is None:
            return self.points(u)
        return self._mean(u)[0]

    def mean_points(self, u: Array) -> ContactPoints:
        """Return the points with the mean pressures and normals of the step."""
        at = self.points_of_step(u)
        x = self.surface.positions(u, at.which)
        normal = self._mean_contact.normals(at.which, x, at.gap, at.normal, self.load)
        return at._replace(normal=normal)

    def lag_mean_normals(self, u: Array) -> tuple[float, float]:
        """Lag what the mean normals add to the forces; return its change, and the force [N]."""
        at, mean = self.points_of_step(u), self.mean_points(u).normal
        change = self._mean_contact.lag(at.which, at.pressure[..., None] * (mean - at.normal))
        return change, float((self.surface.weights[at.which] * at.pressure).sum())

    def _mean(self, u: Array) -> tuple[ContactPoints, MeanPressure]:
        """Return the points of facets that touch in a step, and their mean pressures.

        Multipliers are means themselves: they leave no compliance, whose energy would be given back
        where contact ends.
        """
        near, gap, normal, curvature = self._evaluate(u)
        if self._means and self._means[0] is self._gaps and self._means[1] == self.law.version:
            return self._means[2]
        k, trial = np.broadcast_to(self.law.stiffness[near], gap.shape), self.law.trial(near, gap)
        if self.law.augmented:
            p = np.maximum(trial, 0.0)
            mean = MeanPressure(p**2 / (2 * k), p, np.where(p > 0, k, 0.0))
        else:
            start = self._mean_contact.gaps(near)
            mean = mean_pressure(k, start, gap)
        touching = np.flatnonzero(mean.pressure.any(axis=1))
        found = (near, gap, mean.pressure, normal, curvature)
        at = ContactPoints(*(values[touching] for values in found))
        mean = MeanPressure(*(values[touching] for values in mean))
        self._means = self._gaps, self.law.version, (at, mean)
        return at, mean

    def _end_pressure(self, u: Array) -> tuple[Array, Array, Array]:
        """Return facets, pressures and normals at a step's end, as the step's solution has them.

        In a linearised step these are the points in contact at its start, on the linear branch.
        """
        if not self._start:
            return self.points(u).acting
        near, gap, normal, _ = self._evaluate(u)
        which = self._start[1]
        rows = np.searchsorted(near, which)
        trial = self.law.trial(which, gap[rows])
        return which, np.where(self._start[2], trial, 0.0), normal[rows]

    def _evaluate(self, u: Array) -> tuple[Array, Array, Array, Array]:
        """Return near facets, and gap, normal and curvature at their points.

        A step asks for energy, forces, Hessian and output at the same displacement: the last
        result is kept.
        """
        if self._gaps is not None and np.array_equal(self._gaps[0], u):
            return self._gaps[1]
        near = self._near.at(u)
        if self._start:
            near = np.union1d(near, self._start[1])
        if self.mean_weight is not None:
            near = np.union1d(near, self._mean_contact.which)
        x = self.surface.positions(u, near)
        gap, normal, curvature = self.obstacle.evaluate(x.reshape(-1, 3), self.load)
        found = near, gap.reshape(x.shape[:2]), normal.reshape(x.shape)
        self._gaps = u.copy(), (*found, curvature.reshape(*x.shape, 3))
        return self._gaps[1]

    def deepest(self, u: Array, search: bool) -> DeepestPoint:
        """Return the deepest point of this rank's facets, at nodal displacements (nodes, 3).

        With ``search`` facets that may be deep between the grid's points have finer ones.
        """
        near, gap, _, _ = self._evaluate(u)
        sizes = self.surface.sizes[near]
        found = [DeepestPoint.among(gap, sizes, self.surface.positions(u, near))]
        for intervals in (GRID_INTERVALS, *FINE_INTERVALS):
            grid = facet_grid(self.surface.kind, intervals)
            x = self.surface.positions_at(grid, u, near)
            gaps = self.distance(x.reshape(-1, 3)).reshape(x.shape[:2])
            found.append(DeepestPoint.among(gaps, sizes, x))
            doubtful = may_be_deep(gaps, x, sizes, intervals)
            if not (search and doubtful.any()):
                break
            near, sizes = near[doubtful], sizes[doubtful]
        return DeepestPoint.deepest(found)

    def energy(self, u: Array) -> float:
        """Return the energy of this rank's facets [J]."""
        friction = self.friction.energy(u) if self.friction else 0.0
        if self.mean_weight is not None:
            at, pressure = self._mean(u)
            mean = float((self.surface.weights[at.which] * pressure.energy).sum())
            return self.mean_weight * (mean + self._mean_contact.turn_energy(u) + friction)
        at = self.points(u)
        return self.law.energy(at.which, at.pressure) + friction

    def add_gradient(self, u: Array, r: Array) -> None:
        """Add the energy's derivative [N] to nodal vectors (nodes, 3)."""
        at, weight = self.points_of_step(u), self._weight
        forces = weight * (self.surface.weights[at.which] * at.pressure)[..., None] * at.normal
        self.surface.add_vectors(-forces, at.which, r)
        if self.mean_weight is not None:
            self._mean_contact.add_turn(r, self.mean_weight)
        if self.friction:
            self.friction.add_gradient(u, r, weight)

    def force(self, u: Array) -> Array:
        """Return the force on this rank's facets, friction included [N], (3,)."""
        at = self.points(u)
        weighted = self.surface.weights[at.which] * at.pressure
        force = (weighted[..., None] * at.normal).sum(axis=(0, 1))
        return np.asarray(force - self.friction.force(u) if self.friction else force)

    def matrices(self, u: Array, filter: str) -> tuple[Array, Array, int]:
        """Return cells, their filtered matrices [N/m], and the number of filtered points."""
        at = self.points_of_step(u)
        stiffness = np.where(at.pressure != 0, self.law.stiffness[at.which], 0.0)
        if self.mean_weight is not None:
            stiffness = self._mean(u)[1].stiffness
        curved = -at.pressure[..., None, None] * at.curvature
        some = curved.any(axis=(-2, -1))  # most obstacles are flat, most points without contact
        curved[some], count = filter_matrices(curved[some], filter)
        normal = at.normal
        products = normal[..., :, None] * normal[..., None, :]
        hessian = stiffness[..., None, None] * products + curved
        hessian *= self._weight * self.surface.weights[at.which][..., None, None]
        return self.surface.cells[at.which], self.surface.cell_matrices(hessian, at.which), count

    def friction_matrices(self, u: Array) -> tuple[Array, Array]:
        """Return cells and their matrices of friction [N/m]."""
        assert self.friction
        cells, matrices = self.friction.matrices(u)
        return cells, self._weight * matrices

    @property
    def _weight(self) -> float:
        """The weight of the energy."""
        return 1.0 if self.mean_weight is None else self.mean_weight


def obstacle_work(obstacle: MovingShape, at: PointForces, start: float, end: float) -> float:
    r"""Return the work of forces that move with an obstacle from load ``start`` to ``end`` [J].

    .. math:: W = \sum_q f_q \cdot \tfrac12 \left[d_{0 \to 1}(x_q) - d_{1 \to 0}(x_q)\right]

    with the displacement d of the obstacle's material point at x_q. The central difference leaves
    no work to the normal forces on a body of revolution that turns about its axis.
    """
    if not len(at.x):
        return 0.0
    forth, back = obstacle.displacement(at.x, start, end), obstacle.displacement(at.x, end, start)
    return float((at.forces * (forth - back)).sum() / 2)
