"""A surface and one rigid obstacle: energy, forces, Hessian, work; a part of `obstacle_contact`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.contact.facet_loops import largest_move, same
from fem_snh.contact.law import (
    ContactLaw,
    ContactPoints,
    Friction,
    Response,
    mean_derivative,
    surface_mean,
)
from fem_snh.contact.surface_contact import ContactPair
from fem_snh.contact.surface_quadrature import (
    FINE_INTERVALS,
    GRID_INTERVALS,
    DeepestPoint,
    SurfaceQuadrature,
    may_be_deep,
)
from fem_snh.geometry.motions import MovingShape, Pose
from fem_snh.terms.history import LaggedChange, relative

#: Close facets (m,), and gap, normal and curvature at their points, or other arrays of points.
Evaluated = tuple[Array, Array, Array, Array]

#: Distance by which nodes may move before the facets are searched again, in mean radii of facets. A
#: larger one costs evaluations at more points, a smaller one more searches.
_MARGIN = 1.0
#: Friction has settled when a solve changes its lagged normal forces by less than this fraction.
_SETTLED = 1e-3
#: A step's mean normals have settled when a solve changes the force by less than this fraction.
_TURNED = 1e-4


class NearFacets:
    """The facets that touch the obstacle, and all others that are close to it.

    Along a path a signed distance changes by at most the path's length, so a facet whose centre is
    farther from the obstacle than the facet's radius does not touch it. The list includes facets
    within a margin, and stays valid while no node moves by more than the margin relative to the
    obstacle. Most evaluations only compare positions of nodes.

    Facets in contact at the start of a step are included by `include`, wherever they are.

    Parameters
    ----------
    surface : SurfaceQuadrature
        The facets.
    X : (local nodes, 3)
        Reference coordinates of the displacement's nodes [m].
    distance : callable
        Maps positions (n, 3) to signed distances from the obstacle (n,) [m].
    facets : (n,) int, optional
        Local numbers of the facets that may touch the obstacle. Default: all of the surface.
    pose : callable
        Returns the present pose of the obstacle.
    """

    def __init__(
        self,
        surface: SurfaceQuadrature,
        X: Array,
        distance: Callable[[Array], Array],
        pose: Callable[[], Pose],
        facets: Array | None = None,
    ) -> None:
        chosen = slice(None) if facets is None else np.isin(surface.facets, facets)
        self._indices = np.arange(len(surface), dtype=np.int32)[chosen]
        corners = surface.nodes[chosen]
        self._nodes, nodes = np.unique(corners, return_inverse=True)
        self._corners = nodes.reshape(corners.shape)
        self._X, self._distance, self._pose = X[self._nodes], distance, pose
        # |x_q - c| <= sum |N_a| max |x_a - c|, as the shape functions sum to 1.
        self._spread = np.abs(surface.basis).sum(axis=1).max()
        radii = self._balls(self._X)[1]
        self._margin = _MARGIN * float(radii.mean()) if len(radii) else 0.0
        self._searched: Array | None = None
        self._close = self._included = self._found = self._indices[:0]
        self._valid = 0.0

    def include(self, which: Array) -> None:
        """Include facets ``which``, sorted indices in ``surface``, in what `at` returns."""
        self._included, self._found = which, np.union1d(self._close, which)

    def at(self, u: Array) -> Array:
        """Return the sorted indices of close facets in ``surface``, (m,): often the same array.

        Parameters
        ----------
        u : (local nodes, 3)
            Nodal displacements [m], ghosts included.
        """
        pose = self._pose()
        if self._searched is not None:
            moved = largest_move(self._nodes, self._X, u, pose, self._searched)
            if self._spread * moved <= self._valid:
                return self._found
        x = self._X + u[self._nodes]
        self._searched, (centers, radii) = pose.invert(x), self._balls(x)
        gaps = self._distance(centers) - radii
        self._close = self._indices[gaps <= self._margin]
        self._valid = max(self._margin, gaps.min(initial=np.inf))
        self.include(self._included)
        return self._found

    def _balls(self, x: Array) -> tuple[Array, Array]:
        """Return centres (facets, 3) and radii (facets,) of balls around all quadrature points."""
        corners = x[self._corners]
        centers = corners.mean(axis=1)
        ways = corners - centers[:, None]
        return centers, self._spread * np.sqrt(np.einsum("fki,fki->fk", ways, ways).max(axis=1))


class StepStart:
    r"""The contact of a surface with an obstacle at the start of a time step.

    Newmark's method takes a mean contact force over the step: the mean pressure of `response` times
    the normal of `mean_derivative`, which is second-order accurate where the normal turns. As this
    force is no gradient, the energy has the mean pressure along the normal at the step's end. The
    remaining force per area, ``turn``, is lagged; it is zero at a plane that does not rotate.

    Parameters
    ----------
    surface : SurfaceQuadrature
        The surface of the body.
    obstacle : MovingShape
        The obstacle.

    Attributes
    ----------
    u : (local nodes, 3)
        Nodal displacements at the step's start [m].
    load : float
        The load at the step's start.
    which : (m,) int
        The facets in contact at the step's start.
    turn : (facets, points, 3)
        The lagged force on the body per reference area [Pa].
    """

    def __init__(self, surface: SurfaceQuadrature, obstacle: MovingShape) -> None:
        self._surface, self._obstacle = surface, obstacle
        self.turn: Array = np.zeros(surface.X.shape)
        self.begin(np.zeros((surface.num_nodes, 3)), 0.0, np.empty(0, np.int32))

    def begin(self, u: Array, load: float, which: Array) -> None:
        """Set the step's start: displacements (copied), load, facets in contact; turn is zero."""
        self.u, self.load, self.which = u.copy(), load, which
        self._evaluated: Evaluated | None = None
        self._set_turn(which, 0.0)

    def gaps(self, near: Array) -> Array:
        """Return the gaps of facets ``near`` at the step's start, (m, points) [m]."""
        return self._at_start(near)[2]

    def normals(self, near: Array, x: Array, gap: Array, normal: Array, load: float) -> Array:
        """Return the mean normals of facets ``near`` over the step, not of unit length.

        ``x``, ``gap`` and ``normal`` at their points, and ``load``, are those at the step's end.
        The result has the shape of ``x``, (m, points, 3).
        """
        _, before, old_gap, old_normal = self._at_start(near)
        way = x - before - obstacle_displacement(self._obstacle, before, x, self.load, load)
        size = self._surface.sizes[near, None]
        return mean_derivative((old_normal + normal) / 2, gap - old_gap, way, size)

    def lag(self, near: Array, turn: Array) -> float:
        """Set ``turn`` at facets ``near``, zero elsewhere; return its change's integral [N]."""
        before = self.turn.copy()
        self._set_turn(near, turn)
        change = np.linalg.norm(self.turn - before, axis=2)
        return float((self._surface.weights * change).sum())

    def turn_energy(self, u: Array) -> float:
        """Return minus the work of ``turn`` from the step's start to displacements u [J]."""
        moved = self._surface.displacements(u - self.u, self._turned)
        return -float((self._turn_forces * moved).sum())

    def add_turn(self, r: Array) -> None:
        """Add the derivative of `turn_energy` [N] to nodal vectors ``r`` (local nodes, 3)."""
        if len(self._turned):
            self._surface.add_vectors(-self._turn_forces, self._turned, r)

    def _set_turn(self, near: Array, turn: Array | float) -> None:
        """Set ``turn`` at facets ``near`` and zero elsewhere, and the forces of its points."""
        self.turn[:] = 0.0
        self.turn[near] = turn
        self._turned = np.flatnonzero(self.turn.any(axis=(1, 2)))
        weights = self._surface.weights[self._turned]
        self._turn_forces = weights[..., None] * self.turn[self._turned]

    def _at_start(self, near: Array) -> Evaluated:
        """Return ``near``, and its points' positions, gaps and normals at the step's start."""
        if self._evaluated is None or self._evaluated[0] is not near:
            x = self._surface.positions(self.u, near)
            gap, normal, _ = self._obstacle.evaluate(x.reshape(-1, 3), self.load)
            self._evaluated = near, x, gap.reshape(x.shape[:2]), normal.reshape(x.shape)
        return self._evaluated


class ObstaclePair(ContactPair):
    r"""A surface and an obstacle: the energies of `ContactLaw` and `Friction`.

    The derivatives of the energy of `ContactLaw` are

    .. math:: \frac{\partial E}{\partial x_q} = - w_q p \nabla g, \qquad
        \frac{\partial^2 E}{\partial x_q^2} = w_q \left(k \nabla g \nabla g^T - p \nabla^2 g\right)
        \quad (p > 0)

    As :math:`|\nabla g| = 1`, the normal is an eigenvector of both terms of the Hessian: filtering
    the second term filters their sum. Methods get nodal displacements ``u`` (local nodes, 3) [m],
    ghosts included, and return the share of this rank's facets.

    Parameters
    ----------
    name : str
        Name in run.json.
    surface : SurfaceQuadrature
        The surface of the body.
    X : (local nodes, 3)
        Reference coordinates of the displacement's nodes [m].
    obstacle : MovingShape
        The obstacle.
    law : ContactLaw
        Pressure as a function of the gap; its arrays are (facets, points).
    friction : Friction, optional
        The friction at these points. Default: none.
    facets : (n,) int, optional
        Local numbers of the facets that may touch the obstacle. Default: all of the surface.

    Attributes
    ----------
    name, surface, obstacle, law, friction
        The parameters.
    load : float
        The load at which the obstacle is.
    linearised : bool
        Whether a time step is one linear solve, linearised at the step's start. Points in contact
        at the start then stay on the linear branch :math:`p = \ell - k g`, where p may be negative:
        if the obstacle recedes by more than the penetration, the body follows it instead of
        expanding freely for a step.
    """

    def __init__(
        self,
        name: str,
        surface: SurfaceQuadrature,
        X: Array,
        obstacle: MovingShape,
        law: ContactLaw,
        friction: Friction | None = None,
        facets: Array | None = None,
    ) -> None:
        super().__init__(name, law)
        self.surface, self.obstacle, self.friction = surface, obstacle, friction
        self.load, self.linearised = 0.0, False
        self._near = NearFacets(surface, X, self.distance, self._pose, facets)
        #: At the start of a linearised step: displacement, facets in contact (m,), and which of
        #: their points are in contact (m, points).
        self._linear: tuple[Array, Array, Array] | None = None
        #: What `_weighted_forces` returned at the start of the step.
        self._before: list[tuple[Array, Array]] = []
        self._start = StepStart(surface, obstacle)
        #: The last call of `_evaluate`: displacement, load of a moving obstacle, result.
        self._evaluated: tuple[Array, float, Evaluated] | None = None
        #: The last result of `_respond` for it, and what this depends on.
        self._responded: tuple[tuple[Any, ...], ContactPoints] | None = None

    def set_load(self, load: float) -> None:
        """Move the obstacle to its position at a load, for friction too."""
        self.load = load
        if self.friction:
            self.friction.set_load(load)

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the penalty stiffness, normal and tangential; return whether there is one.

        With multipliers only the tangential stiffness of friction is a penalty.
        """
        if self.friction:
            self.friction.scale_stiffness(factor)
        return super().scale_penalties(factor) or self.friction is not None

    def begin_step(self, u: Array) -> None:
        """Reset the law to the last accepted step; store the contact state at ``u``."""
        self.law.begin_step()
        self._linear = self._responded = None
        at = self.points(u)
        touches = at.pressure.any(axis=1)
        if self.linearised:
            touching = at.which[touches], at.pressure[touches] > 0
            self._linear, self._responded = (u.copy(), *touching), None
        if self.friction:
            self.friction.begin_step(u, self.load, at)
        self._start.begin(u, self.load, at.which[touches])
        self._near.include(self._start.which)
        self._before = self._weighted_forces(u, at)

    def end_step(self, u: Array) -> None:
        """Store the multipliers and the elastic part of the slip, as the step is accepted."""
        self._linear = self._responded = None
        super().end_step(u)
        if self.friction:
            self.friction.keep(u)

    def settle(self, u: Array) -> list[LaggedChange]:
        """Update multipliers, mean normals and lagged friction; return their changes.

        Collective. The changes are the same on all ranks.
        """
        at = self.points(u)
        changes, comm = self.law.settle(*at[:3]), self.law.comm
        if self.mean_weight is not None:
            present, at = self.points_of_step(u), self._mean_points(u)
            turn = present.pressure[..., None] * (at.normal - present.normal)
            force = float((self.surface.weights[at.which] * at.pressure).sum())
            sums = comm.allreduce(np.array([self._start.lag(at.which, turn), force]))
            change, force = sums.tolist()
            what = f"obstacle '{self.name}': the change of the mean normals"
            changes.append(LaggedChange(relative(change, force, _TURNED), what))
        if self.friction:
            ratio = self.friction.settle(at, comm, _SETTLED)
            what = f"obstacle '{self.name}': the change of friction's normal forces"
            changes.append(LaggedChange(ratio, what))
        return changes

    def work(self, u: Array, end_weight: float) -> tuple[float, float]:
        """Return the obstacle's work on the body in a step, and the energy lost to friction [J].

        Both are sums over this rank's facets: see `fem_snh.terms.term.WorkingTerm.step_work`. With
        mean forces ``end_weight`` is 1. In a linearised step the linearised forces do the work.
        """
        mean = self.mean_weight is not None
        if mean:
            end_weight = 1.0
        lost = self.friction.dissipated(u, end_weight) if self.friction else 0.0
        if self.obstacle.motion is None:
            return 0.0, lost
        start, at = self._start.u, self._mean_points(u) if mean else self._end_points(u)
        work = end_weight * self._work_of(self._weighted_forces(u, at), start if mean else u, u)
        return work + (1 - end_weight) * self._work_of(self._before, start, start), lost

    def acting(self, u: Array) -> tuple[Array, Array, Array]:
        """Return facets (m,), gaps [m] and pressures [Pa], both (m, points)."""
        return self.points(u)[:3]

    def distance(self, x: Array) -> Array:
        """Return the signed distance of positions (n, 3) from the obstacle, (n,) [m]."""
        return self.obstacle.distance(x, self.load)

    def points(self, u: Array) -> ContactPoints:
        """Return the points of close facets, with the pressures at ``u``.

        At the start of a linearised step, pressures are those of the linear branch.
        """
        return self._respond(self._evaluate(u), u, mean=False)

    def points_of_step(self, u: Array) -> ContactPoints:
        """Return the points with mean pressures over the step, or without means those at u."""
        return self._respond(self._evaluate(u), u, self.mean_weight is not None)

    def deepest(self, u: Array, search: bool) -> DeepestPoint:
        """Return the deepest point of this rank's close facets.

        With ``search``, facets that may be deep between grid points get up to two finer grids.
        """
        near, gap, _, _ = self._evaluate(u)
        if not len(near):
            return DeepestPoint()
        sizes = self.surface.sizes[near]
        found = [DeepestPoint.among(gap, sizes, self.surface.positions(u, near))]
        for intervals in (GRID_INTERVALS, *FINE_INTERVALS):
            x = self.surface.grid_positions(intervals, u, near)
            gaps = self.distance(x.reshape(-1, 3)).reshape(x.shape[:2])
            found.append(DeepestPoint.among(gaps, sizes, x))
            if not search or not (doubtful := may_be_deep(gaps, x, sizes, intervals)).any():
                break
            near, sizes = near[doubtful], sizes[doubtful]
        return DeepestPoint.deepest(found)

    def energy(self, u: Array) -> float:
        """Return the energy of contact and friction of this rank's facets [J]."""
        at = self.points_of_step(u)
        energy = self.law.energy(at.which, at.energy)
        if self.mean_weight is not None:
            energy += self._start.turn_energy(u)
        if self.friction:
            energy += self.friction.energy(u)
        return self.weight * energy

    def gradient(self, u: Array) -> Array:
        """Return the energy's derivative by nodal displacements, (local nodes, 3) [N]."""
        r = np.zeros_like(u)
        for which, forces in self._weighted_forces(u, self.points_of_step(u)):
            if len(which):
                self.surface.add_vectors(-forces, which, r)
        if self.mean_weight is not None:
            self._start.add_turn(r)
        return self.weight * r

    def nodal_forces(self, u: Array) -> Array:
        """Return the obstacle's forces on the body, friction included, (local nodes, 3) [N]."""
        return -self.gradient(u)

    def force_derivative(self, component: int, u: Array) -> Array:
        """Return the derivative of a component of the force by u, (local nodes, c) [N/m].

        Friction is left out; c is the number of the displacement's components.
        """
        cells, matrices, _ = self.matrices(u, "exact")
        nodes = _dolfinx.node_dofs(self.surface.V)[cells]
        out = np.zeros((len(u), matrices.shape[1] // nodes.shape[1]))
        # The Hessian times a translation of all nodes is minus the derivative of the force.
        blocks = matrices.reshape(*nodes.shape, out.shape[1], *nodes.shape[1:], out.shape[1])
        np.add.at(out, nodes, -blocks[..., component].sum(axis=3))
        return out

    def matrices(self, u: Array, filter: str) -> tuple[Array, Array, int]:
        """Return cells (m,), their Hessians without friction, and the number of filtered points.

        The Hessians (m, n, n) [N/m], filtered at each point, are of a cell's n displacement dofs.
        """
        at = self.points_of_step(u)
        columns = at.pressure, at.stiffness, at.normal, at.curvature
        rows, matrices, count = self.surface.loops.contact_matrices(
            at.which, columns, filter, self.weight
        )
        return self.surface.cells[at.which[rows]], matrices, count

    def add_hessian(self, u: Array, filter: str, target: BlockMatrix) -> int:
        """Add the Hessians of `matrices` and of friction; return the number of filtered points."""
        cells, matrices, filtered = self.matrices(u, filter)
        target.add_matrices(cells, matrices)
        if self.friction:
            cells, matrices = self.friction.matrices(u)
            target.add_matrices(cells, self.weight * matrices)
        return filtered

    def row(self, u: Array) -> dict[str, Any]:
        """Return the obstacle's row of run.json. Collective.

        `ContactPair.row` and: ``stiffness`` [Pa/m], the present penalty stiffness, averaged over
        the surface; ``pose``, the rows [R | c] of the map from the obstacle's reference position to
        its present one; with friction ``sliding``, the number of points that slide.
        """
        row = super().row(u) | {
            "pose": self.obstacle.affine(self.load),
            "stiffness": surface_mean(self.surface, self.law.stiffness[:, 0]),
        }
        if self.friction:
            row["sliding"] = self.law.comm.allreduce(self.friction.sliding(u))
        return row

    def _pose(self) -> Pose:
        """Return the obstacle's present pose."""
        return self.obstacle.pose(self.load)

    def _work_of(self, forces: list[tuple[Array, Array]], before: Array, after: Array) -> float:
        """Return the work of `_weighted_forces` during the obstacle's motion in the step [J].

        ``before`` and ``after`` are the nodal displacements for `obstacle_displacement`.
        """
        x, work, loads = self.surface.positions, 0.0, (self._start.load, self.load)
        for which, values in forces:
            ends = x(before, which), x(after, which)
            work += float((values * obstacle_displacement(self.obstacle, *ends, *loads)).sum())
        return work

    def _weighted_forces(self, u: Array, at: ContactPoints) -> list[tuple[Array, Array]]:
        """Return facets (m,) and forces on the body at their points (m, points, 3) [N].

        One tuple is for normal contact, a second one, if any, for friction.
        """
        forces = self.surface.loops.contact_forces(at.which, at.pressure, at.normal)
        found = [(at.which, forces)]
        if self.friction:
            found.append(self.friction.weighted_forces(u))
        return found

    def _mean_points(self, u: Array) -> ContactPoints:
        """Return the points with mean pressures and mean normals over the step."""
        at = self.points_of_step(u)
        x = self.surface.positions(u, at.which)
        return at._replace(normal=self._start.normals(at.which, x, at.gap, at.normal, self.load))

    def _end_points(self, u: Array) -> ContactPoints:
        """Return the points with the pressures of the step's solution at its end.

        In a linearised step these are the points in contact at its start, on the linear branch;
        their ``energy`` and ``stiffness`` are not set (both hold the pressure).
        """
        if not self._linear:
            return self.points(u)
        at = self._evaluate(u)
        pressure = np.where(self._on_linear_branch(at[0]), self.law.trial(*at[:2]), 0.0)
        return _points(at, Response(pressure, pressure, pressure))

    def _respond(self, at: Evaluated, u: Array, mean: bool) -> ContactPoints:
        """Return the points of `_evaluate`, with mean pressures over the step if ``mean``.

        The last result is cached.
        """
        depends = self.law.version, mean
        if self._responded is None or self._responded[0] != depends:
            near, gap = at[:2]
            found = self.law.response(near, gap, self._start.gaps(near) if mean else None)
            if not mean and self._linear and same(self._linear[0], u):
                linear = self._on_linear_branch(near)
                pressure = np.where(linear, self.law.trial(near, gap), found.pressure)
                energy = pressure**2 / (2 * found.stiffness)
                found = Response(energy, pressure, found.stiffness)
            self._responded = depends, _points(at, found)
        return self._responded[1]

    def _on_linear_branch(self, near: Array) -> Array:
        """Return which points are in contact at the start of a linearised step, (m, points)."""
        found = np.zeros((len(near), len(self.surface.points)), bool)
        if self._linear:
            found[np.searchsorted(near, self._linear[1])] = self._linear[2]
        return found

    def _evaluate(self, u: Array) -> Evaluated:
        """Return close facets (m,), and gap, normal and curvature as in `ContactPoints`.

        The last result is cached.
        """
        load = self.load if self.obstacle.motion else 0.0
        if self._evaluated is not None and self._evaluated[1] == load:
            if same(self._evaluated[0], u):
                return self._evaluated[2]
        near = self._near.at(u)
        x = self.surface.positions(u, near)
        gap, normal, curvature = self.obstacle.evaluate(x.reshape(-1, 3), self.load)
        found = near, gap.reshape(x.shape[:2]), normal.reshape(x.shape)
        self._evaluated = u.copy(), load, (*found, curvature.reshape(*x.shape, 3))
        self._responded = None
        return self._evaluated[2]


def _points(at: Evaluated, response: Response) -> ContactPoints:
    """Return the points of the facets of `ObstaclePair._evaluate`."""
    near, gap, normal, curvature = at
    energy, pressure, stiffness = response
    return ContactPoints(near, gap, pressure, normal, curvature, stiffness, energy)


def obstacle_displacement(
    obstacle: MovingShape, before: Array, after: Array, start: float, end: float
) -> Array:
    r"""Return the obstacle's displacement at points of the body from one load to another [m].

    .. math:: \tfrac12 \left[d_{0 \to 1}(x_0) - d_{1 \to 0}(x_1)\right]

    where :math:`d_{0 \to 1}(x)` is the displacement, from the first load to the second, of the
    obstacle's material point at x. With this central difference normal forces do no work on an
    obstacle of revolution that turns about its axis. The result has the shape of ``after``.

    Parameters
    ----------
    obstacle : MovingShape
        The obstacle.
    before, after : (..., 3)
        Positions x_0 at the first load and x_1 at the second load [m].
    start, end : float
        The two loads.
    """
    if obstacle.motion is None:
        return np.zeros_like(after)
    forth = obstacle.displacement(before.reshape(-1, 3), start, end)
    back = obstacle.displacement(after.reshape(-1, 3), end, start)
    return np.asarray((forth - back).reshape(after.shape) / 2)
