"""The term of contact with rigid moving obstacles, with friction, and its fields at the nodes."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.assembly.unknowns import summed_over_ranks
from fem_snh.contact.law import ContactLaw, Friction, cell_heights, default_stiffness
from fem_snh.contact.obstacle_pair import ObstaclePair
from fem_snh.contact.surface_contact import SurfaceContact
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.geometry.motions import MovingShape
from fem_snh.records.output_fields import AT_OBSTACLES, CONTACT_PRESSURES
from fem_snh.terms.term import MeanForceTerm, WorkingTerm

#: Degree of the quadrature on facets: 2 x 2 points of quadrilaterals, 3 of triangles, 2 of curves.
#: A constant pressure is integrated exactly for elements of degree 1 and 2. With more points than a
#: facet can follow, the pressure oscillates: in the scene hertz (depth 0.2, 0.5 and 2) the largest
#: pressure is 1.08 to 1.18 times Hertz's with 6 points, 1.03 to 1.07 times with 3 points.
_DEGREE = {"quadrilateral": 3, "triangle": 2, "interval": 3}
#: Degree for elements of degree 3, which bulge between so few points: 3 x 3, 6 and 3 points.
_DEGREE_3 = {"quadrilateral": 5, "triangle": 4, "interval": 5}
#: An obstacle whose force is below this fraction of the largest obstacle's force is no reason for
#: finer cells (`fem_snh.accuracy.goal_errors.SMALL_FORCE`).
_SMALL_FORCE = 0.1
#: Tangential over normal penalty stiffness: a sticking point then moves by at most the friction
#: coefficient times the penetration.
_TANGENTIAL = 1.0


class RigidContact(NamedTuple):
    """A rigid obstacle, and the parameters of the body's contact with it.

    Attributes
    ----------
    name : str
        Name in run.json.
    obstacle : MovingShape
        Shape and motion.
    friction : float
        Coulomb's coefficient.
    stiffness : float or None
        Penalty stiffness [Pa/m]; None for the default.
    tolerance : float or None
        Largest penetration [m] with the augmented Lagrangian; None for the default.
    augmented : bool
        Whether multipliers reduce the penetration below the tolerance.
    facets : (n,) int or None
        Local numbers of the facets that may touch the obstacle; None for the whole boundary.
    limits_force : bool
        With the default tolerance: whether augmentations go on until they change the force by
        little, too (`fem_snh.contact.law.FORCE_TOLERANCE`). False in time, where the next step
        makes up for the force that a step lacks.
    """

    name: str
    obstacle: MovingShape
    friction: float = 0.0
    stiffness: float | None = None
    tolerance: float | None = None
    augmented: bool = False
    facets: Any = None
    limits_force: bool = True


class ObstacleContact(SurfaceContact, WorkingTerm, MeanForceTerm):
    r"""The energy of contact of a body's whole surface with rigid obstacles. Collective.

    .. math:: E = \sum_q \frac{w_q}{2 k} \left(\langle \ell - k g(x_q)\rangle^2 - \ell^2\right)

    The symbols are those of `ContactLaw`. `ObstaclePair` has the derivatives; `Friction` adds
    another energy. Multipliers and lagged friction are constant during a solve and updated after
    it: with an augmented Lagrangian until every point in contact is within the tolerance of the
    obstacle, with friction until the normal forces have settled. In time, Newmark's method takes
    means over a step: `fem_snh.contact.facet_loops.response`.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    regions : sequence of Region
        The materials, which the default stiffness depends on.
    contacts : sequence of RigidContact
        The obstacles.
    kinematics : Kinematics, optional
        Kinematics of the displacement.

    Attributes
    ----------
    contacts : list of RigidContact
        The obstacles.
    surface : SurfaceQuadrature
        This rank's facets of the whole boundary.
    pairs : list of ObstaclePair
        The contact with each obstacle, in the order of ``contacts``.
    depends_on_load : bool
        Whether an obstacle moves.
    """

    name, key = "obstacle", "obstacles"
    pairs: list[ObstaclePair]

    def __init__(
        self,
        V: FunctionSpace,
        regions: Sequence[Region],
        contacts: Sequence[RigidContact],
        kinematics: Kinematics = SOLID,
    ) -> None:
        super().__init__(V, kinematics)
        self.contacts = list(contacts)
        self._fields: ObstacleFields | None = None
        degrees = _DEGREE_3 if _dolfinx.degree(V) == 3 else _DEGREE
        degree = degrees[_dolfinx.FACET_OF[_dolfinx.cell_name(V.mesh)]]
        self.surface = surface = SurfaceQuadrature(V, None, degree, kinematics.revolved)
        X = V.tabulate_dof_coordinates()
        heights = cell_heights(surface)[:, None]
        default = default_stiffness(surface, regions)[:, None]
        self.pairs = []
        for c in contacts:
            law = ContactLaw(c, "obstacle", surface.weights, default, heights, comm=self.comm)
            friction = None
            if c.friction:
                stiffness = _TANGENTIAL * law.stiffness[:, 0]
                friction = Friction(surface, c.obstacle, c.friction, stiffness)
            pair = ObstaclePair(c.name, surface, X, c.obstacle, law, friction, c.facets)
            self.pairs.append(pair)
        self.depends_on_load = any(c.obstacle.motion is not None for c in contacts)

    @property
    def surfaces(self) -> list[MovingShape]:
        """The obstacles' shapes with their motions."""
        return [c.obstacle for c in self.contacts]

    @property
    def extent(self) -> float:
        """The largest finite coordinate of the shapes [m], to which gaps' rounding is relative."""
        bounds = np.array([shape.shape.bounds for shape in self.surfaces])
        return float(np.abs(bounds, where=np.isfinite(bounds), out=np.zeros(bounds.shape)).max())

    def set_load(self, load: float) -> None:
        """Move the obstacles to their positions at a load."""
        for pair in self.pairs:
            pair.set_load(load)

    def narrow(self, u: PETSc.Vec) -> list[str]:
        """Return the names of obstacles whose contact is narrower than a facet. Collective.

        They touch quadrature points, but on no facet all of them. Obstacles whose force is small
        beside another obstacle's are left out.
        """
        x, rows = self.configuration(u), []
        for pair in self.pairs:
            touched = pair.points(x).pressure > 0
            counts = touched.any(), touched.all(axis=1).any()
            rows.append([*pair.nodal_forces(x).sum(axis=0), *counts])
        found = self._sum(np.array(rows, float))
        sizes = np.linalg.norm(found[:, :3], axis=1)
        chosen = (found[:, 3] > 0) & (found[:, 4] == 0) & (sizes >= _SMALL_FORCE * sizes.max())
        return [self.pairs[i].name for i in np.flatnonzero(chosen)]

    def nodal_field(self, name: str, u: PETSc.Vec) -> Array | float:
        """Return a field of `ObstacleFields` at this rank's nodes, (local nodes,). Collective.

        For another field the result is 0.
        """
        if name not in AT_OBSTACLES:
            return 0.0
        if self._fields is None:
            self._fields = ObstacleFields(self._V, self.pairs, self._kinematics)
        return self._fields.evaluate(name, self.configuration(u))

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return the obstacles' work in a step and the energy lost to friction [J]. Collective."""
        x = self.configuration(u)
        work, lost = self._sum(np.sum([pair.work(x, end_weight) for pair in self.pairs], axis=0))
        return float(work), float(lost)

    def history(self) -> tuple[Array, Array]:
        """Return this rank's quadrature points (n, 3) [m] and kept values there, (n, k).

        Columns: multiplier [Pa] and stiffness factor of each pair with multipliers, then elastic
        slip [m] of each pair with friction. Without columns there are no points.
        """
        columns = [column for law in self._augmented for column in law.history()]
        columns += [friction.slip.reshape(-1, 3) for friction in self._frictions]
        points = self.surface.X.reshape(-1, 3)
        return (points, np.hstack(columns)) if columns else (points[:0], np.empty((0, 0)))

    def set_history(self, values: Array) -> None:
        """Set the kept values, (n, k), with rows and columns as in `history`. Collective."""
        first = 0
        for law in self._augmented:
            law.set_history(values[:, first], values[:, first + 1], self.comm)
            first += 2
        for friction in self._frictions:
            friction.slip[:] = values[:, first : first + 3].reshape(friction.slip.shape)
            first += 3

    @property
    def _augmented(self) -> list[ContactLaw]:
        return [pair.law for pair in self.pairs if pair.law.augmented]

    @property
    def _frictions(self) -> list[Friction]:
        return [pair.friction for pair in self.pairs if pair.friction]


class ObstacleFields:
    """The fields of `fem_snh.records.output_fields.AT_OBSTACLES` at the nodes. Collective.

    ``gap`` is the signed distance of each node from the closest obstacle [m].
    ``contact_pressure`` is the normal contact force per deformed area [Pa],
    ``nominal_contact_pressure`` per reference area. At a vertex a pressure is the mean over its
    facets, weighted by the shape function of degree 1; at other nodes it is interpolated between
    the vertices of a cell.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    pairs : sequence of ObstaclePair
        The contact with each obstacle.
    kinematics : Kinematics, optional
        Kinematics of the displacement.
    """

    def __init__(
        self, V: FunctionSpace, pairs: Sequence[ObstaclePair], kinematics: Kinematics = SOLID
    ) -> None:
        self._pairs, self._X = pairs, V.tabulate_dof_coordinates()
        self._space = Q = _dolfinx.function_space(V.mesh, 1)
        self._surface = SurfaceQuadrature(Q, None, pairs[0].surface.degree, kinematics.revolved)
        nodes = _dolfinx.reference_nodes(_dolfinx.cell_name(V.mesh), _dolfinx.degree(V))
        self._table = _dolfinx.tabulate_values(Q, nodes)
        self._nodes, self._num_nodes = _dolfinx.node_dofs(V), sum(_dolfinx.num_nodes(V))

    def evaluate(self, name: str, values: Array) -> Array:
        """Return the field ``name`` at nodal displacements (local nodes, 3), (local nodes,)."""
        if name in CONTACT_PRESSURES:
            return self._pressure(values, nominal=name != "contact_pressure")
        x = self._X + values
        return np.asarray(np.min([pair.distance(x) for pair in self._pairs], axis=0))

    def _pressure(self, values: Array, nominal: bool) -> Array:
        """Return the contact pressure at nodal displacements (local nodes, 3), (local nodes,)."""
        weights = self._surface.weights
        force = np.zeros_like(weights)
        for pair in self._pairs:
            points = pair.points(values)
            force[points.which] += weights[points.which] * points.normal_forces[0]
        areas = weights if nominal else self._pairs[0].surface.deformed_weights(values)
        found, areas = self._sums(force), self._sums(areas)
        found = np.divide(found, areas, out=found, where=areas > 0)
        nodal = np.zeros(self._num_nodes)
        nodal[self._nodes] = found[_dolfinx.node_dofs(self._space)] @ self._table.T
        return nodal

    def _sums(self, weighted: Array) -> Array:
        """Return the sums of values at points times each shape function of degree 1.

        ``weighted`` (facets, points) includes the weights. The result, (local vertices,), is
        summed over all ranks.
        """
        sums = np.zeros((self._surface.num_nodes, 1))
        self._surface.add_vectors(weighted[..., None], slice(None), sums)
        return summed_over_ranks(self._space, sums)[:, 0]
