"""Contact of a body's surface with rigid moving obstacles, with friction."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.ghosted_vectors import local_values, writable_values
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.regions import Region
from fem_snh.choices import FILTERS
from fem_snh.contact.fields import ObstacleFields
from fem_snh.contact.friction import Friction
from fem_snh.contact.law import TOLERANCE, ContactLaw, cell_heights, default_stiffness, surface_mean
from fem_snh.contact.obstacle_pair import ObstaclePair
from fem_snh.contact.surface_quadrature import DeepestPoint, SurfaceQuadrature
from fem_snh.errors import choose
from fem_snh.geometry.motions import MovingShape
from fem_snh.terms.history import HistoryTerm, MeanForceTerm, WorkingTerm
from fem_snh.terms.settling import LaggedChange, largest_change, relative
from fem_snh.terms.term import ForceTerm

Array = npt.NDArray[Any]

#: Degree of the quadrature on facets: 2 x 2 points of quadrilaterals, 3 of triangles, 2 of curves.
#: A constant pressure is integrated exactly for elements of degree 1 and 2. With more points than a
#: facet can follow the pressure oscillates: in the scene hertz (depth 0.2, 0.5 and 2) the largest
#: of all points is 1.08 to 1.18 times Hertz's with 6 points, 1.03 to 1.07 times with 3.
_DEGREE = {"quadrilateral": 3, "triangle": 2, "interval": 3}
#: The same of elements of degree 3, which bulge between so few points: 3 x 3, 6 and 3 points.
_DEGREE_3 = {"quadrilateral": 5, "triangle": 4, "interval": 5}
#: Part of the largest force of an obstacle below which a contact is no reason for finer cells
#: (`fem_snh.accuracy.goal_errors.SMALL_FORCE`).
_SMALL_FORCE = 0.1
#: Tangential stiffness of friction in the normal stiffness: a sticking point then moves by at most
#: the friction coefficient times the penetration.
_TANGENTIAL = 1.0
#: Friction has settled when its lagged normal forces change by less than this in a solve.
_SETTLED = 1e-3
#: Mean normals of a step have settled when they change the force by less than this in a solve.
_TURNED = 1e-4


class RigidContact(NamedTuple):
    """An obstacle, and how the body touches it.

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
        Local numbers of the facets that may touch it; None for the whole boundary.
    limits_force : bool
        With the default tolerance, whether the change of the force is limited, too. In time it need
        not be: what a step's force lacks, the next one has.
    """

    name: str
    obstacle: MovingShape
    friction: float = 0.0
    stiffness: float | None = None
    tolerance: float | None = None
    augmented: bool = False
    facets: Any = None
    limits_force: bool = True


class ObstacleContact(HistoryTerm, WorkingTerm, MeanForceTerm, ForceTerm):
    r"""The energy of contact of a body's whole surface with rigid obstacles. Collective.

    .. math:: E = \sum_q \frac{w_q}{2 k} \left(\langle \ell - k g(x_q)\rangle^2 - \ell^2\right)

    `ObstaclePair` has the derivatives, `Friction` its own energy. Multipliers and the lagged forces
    of friction are constant in a solve and updated after it: with an augmented Lagrangian
    until no point in contact is farther from the obstacle than the tolerance, with friction until
    the normal forces have settled. In time, Newmark's method has contact as the mean over a step:
    `fem_snh.contact.mean_contact.MeanContact`.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    regions : sequence of Region
        The materials, which the default stiffness depends on.
    contacts : sequence of RigidContact
        The obstacles.
    kinematics : Kinematics, optional
        That of the displacement.

    Attributes
    ----------
    pairs : list of ObstaclePair
        The contact with each obstacle.
    depends_on_load : bool
        Whether an obstacle moves.
    """

    name, has_penalties, is_contact = "obstacle", True, True

    def __init__(
        self,
        V: Any,
        regions: Sequence[Region],
        contacts: Sequence[RigidContact],
        kinematics: Kinematics = SOLID,
    ) -> None:
        self.comm, self.contacts, self._V = V.mesh.comm, list(contacts), V
        self._kinematics = kinematics
        self._fields: ObstacleFields | None = None
        degrees = _DEGREE_3 if _dolfinx.degree(V) == 3 else _DEGREE
        degree = degrees[_dolfinx.FACET_OF[_dolfinx.cell_name(V.mesh)]]
        self.surface = surface = SurfaceQuadrature(V, None, degree, kinematics.revolved)
        self.X = V.tabulate_dof_coordinates()
        heights, default = cell_heights(surface, V), default_stiffness(surface, V, regions)
        self.pairs = list[ObstaclePair]()
        for c in contacts:
            k = default if c.stiffness is None else np.full(len(surface), c.stiffness)
            ratio = self.comm.allreduce((default / k).max(initial=0.0), op=MPI.MAX)
            law = ContactLaw(
                f"obstacle '{c.name}'",
                surface.weights,
                k[:, None],
                ratio,
                c.augmented,
                TOLERANCE * heights[:, None] if c.tolerance is None else c.tolerance,
                c.tolerance is None and c.limits_force,
                self.comm,
            )
            friction = Friction(surface, c.obstacle, c.friction, _TANGENTIAL * k)
            self.pairs.append(
                ObstaclePair(
                    surface, self.X, c.obstacle, law, friction if c.friction else None, c.facets
                )
            )
        self.depends_on_load = any(c.obstacle.motion is not None for c in contacts)

    @property
    def surfaces(self) -> list[MovingShape]:
        """The obstacles."""
        return [c.obstacle for c in self.contacts]

    @property
    def extent(self) -> float:
        """The largest finite coordinate of the shapes [length]: gaps are as accurate as it is."""
        bounds = np.array([shape.shape.bounds for shape in self.surfaces])
        return float(np.abs(bounds, where=np.isfinite(bounds), out=np.zeros(bounds.shape)).max())

    def set_load(self, load: float) -> None:
        """Move the obstacles to their positions at a load."""
        for pair in self.pairs:
            pair.set_load(load)

    def weight_mean_forces(self, weight: float | None) -> None:
        """Set the weight of a step's mean forces: see `MeanForceTerm`."""
        for pair in self.pairs:
            pair.weight_mean_forces(weight)

    def scale_penalties(self, factor: float) -> bool:
        """Multiply the stiffness of penalties; return whether there are any."""
        return any([pair.scale_penalties(factor) for pair in self.pairs])

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of contact and friction [J]. Collective."""
        values = self._nodal(u)
        local = sum(pair.energy(values) for pair in self.pairs)
        return float(self.comm.allreduce(local, op=MPI.SUM))

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Add the forces [N] to all entries of ``r_u``, ghosts included."""
        values = self._nodal(u)
        r = writable_values(r_u).reshape(-1, self._kinematics.components)
        for pair in self.pairs:
            pair.add_gradient(values, r)

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add the filtered Hessian; return how many points of this rank were filtered."""
        choose("filter", filter, FILTERS)
        values, count = self._nodal(u), 0
        for pair in self.pairs:
            cells, matrices, filtered = pair.matrices(values, filter)
            target.add_matrices(cells, matrices)
            count += filtered
            if pair.friction:
                target.add_matrices(*pair.friction_matrices(values))
        return count

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, dict[str, Any]]]:
        """Return the rows of the obstacles for run.json, by name. Collective.

        ``force`` [N], which the obstacle exerts on the body; ``contacts``, the number of quadrature
        points in contact; ``penetration`` [m], their largest; ``deepest`` and ``deepest_at`` of
        `DeepestPoint.row`; ``stiffness`` [Pa/m], the penalty's, as a mean over the surface;
        ``pose``, the rows [R | c] of the map from the obstacle's reference position to its present
        one. With friction ``sliding``, how many of the points slide.
        """
        rows, comm, values = dict[str, dict[str, Any]](), self.comm, self._nodal(u)
        for contact, pair in zip(self.contacts, self.pairs, strict=True):
            at, friction = pair.points(values), pair.friction
            slides = friction.sliding(values) if friction else 0
            counts = comm.allreduce(
                np.array([*pair.force(values), (at.pressure > 0).sum(), slides])
            )
            depth = max(0.0, -at.gap.min(initial=0.0))  # max: not -0.0
            penetration = float(comm.allreduce(depth, op=MPI.MAX))
            # Without a force the depth must be found wherever it is; with one the grid's points do.
            found = pair.deepest(values, search=counts[3] == 0)
            deepest = DeepestPoint.deepest(comm.allgather(found))
            row: dict[str, Any] = {
                "force": counts[:3].tolist(),
                "contacts": int(counts[3]),
                "penetration": penetration,
                **deepest.row(penetration),
                "pose": np.column_stack(contact.obstacle.pose(pair.load)).tolist(),
                "stiffness": surface_mean(self.surface, pair.law.stiffness[:, 0], comm),
            }
            if friction:
                row["sliding"] = int(counts[4])
            rows[contact.name] = row
        return {"obstacles": rows}

    def narrow(self, u: PETSc.Vec) -> list[str]:
        """Return the obstacles that touch points, but all those of no facet. Collective.

        Those whose force is small beside that of another obstacle are left out.
        """
        values = self._nodal(u)
        rows = []
        for pair in self.pairs:
            touched = pair.points(values).pressure > 0
            counts = touched.any(), touched.all(axis=1).any()
            rows.append(self.comm.allreduce(np.array([*pair.force(values), *counts], float)))
        found = np.array(rows)
        sizes = np.linalg.norm(found[:, :3], axis=1)
        chosen = (found[:, 3] > 0) & (found[:, 4] == 0) & (sizes >= _SMALL_FORCE * sizes.max())
        return [self.contacts[i].name for i in np.flatnonzero(chosen)]

    @property
    def goals(self) -> list[str]:
        """The names of the obstacles' forces: see `Term.goals`."""
        return [f"{contact.name}.force" for contact in self.contacts]

    def goal(self, name: str, u: PETSc.Vec) -> Array:
        """Return a force on the body [N]: see `Term.goals`. Collective."""
        pair = self.pairs[self.goals.index(name)]
        return np.asarray(self.comm.allreduce(pair.force(self._nodal(u))))

    def add_nodal_forces(self, name: str, u: PETSc.Vec, r: PETSc.Vec) -> None:
        """Add the nodal forces of a force: see `fem_snh.terms.term.ForceTerm`."""
        pair, forces = self.pairs[self.goals.index(name)], writable_values(r)
        gradient = np.zeros_like(forces).reshape(-1, self._kinematics.components)
        pair.add_gradient(self._nodal(u), gradient)
        forces -= gradient.ravel()

    def add_goal_derivative(self, name: str, component: int, u: PETSc.Vec, g: PETSc.Vec) -> None:
        """Add the derivative of a force without its friction: see `Term.goals`."""
        cells, matrices, _ = self.pairs[self.goals.index(name)].matrices(self._nodal(u), "exact")
        out = writable_values(g).reshape(-1, self._kinematics.components)
        nodes = _dolfinx.node_dofs(self._V)[cells]
        # The Hessian times a translation of all nodes is minus the derivative of the force.
        blocks = matrices.reshape(*nodes.shape, out.shape[1], *nodes.shape[1:], out.shape[1])
        np.add.at(out, nodes, -blocks[..., component].sum(axis=3))

    def nodal_field(self, name: str, u: PETSc.Vec) -> Array:
        """Return a field of `ObstacleFields`: see `Term.nodal_field`. Collective."""
        if self._fields is None:
            self._fields = ObstacleFields(self._V, self.pairs, self._kinematics)
        return self._fields.evaluate(name, u)

    def _nodal(self, u: PETSc.Vec) -> Array:
        """Return nodal displacements (local nodes, 3)."""
        return self._kinematics.padded(local_values(u))

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset multipliers and friction to those of the last accepted step."""
        values = self._nodal(u)
        for pair in self.pairs:
            pair.begin_step(values)

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Update multipliers and lagged forces; return their largest change. Collective."""
        values, changes = self._nodal(u), list[LaggedChange]()
        for c, pair in zip(self.contacts, self.pairs, strict=True):
            at = pair.points(values)
            changes += pair.law.settle(*at[:3])
            if pair.mean_weight is not None:
                sums = self.comm.allreduce(np.array(pair.lag_mean_normals(values)))
                change, force = sums.tolist()
                what = f"obstacle '{c.name}': the change of the mean normals"
                changes.append(LaggedChange(relative(change, force, _TURNED), what))
                at = pair.mean_points(values)
            if pair.friction:
                ratio = pair.friction.settle(at, self.comm, _SETTLED)
                what = f"obstacle '{c.name}': the change of friction's normal forces"
                changes.append(LaggedChange(ratio, what))
        return largest_change(changes)

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return the work of moving obstacles in a step, and what friction dissipated [J]."""
        values = self._nodal(u)
        local = np.sum([pair.work(values, end_weight) for pair in self.pairs], axis=0)
        work, lost = self.comm.allreduce(local).tolist()
        return work, lost

    def end_step(self, u: PETSc.Vec) -> None:
        """Keep multipliers, and the elastic part of the slip."""
        values = self._nodal(u)
        for pair in self.pairs:
            pair.end_step(values)

    def history(self) -> tuple[Array, Array]:
        """Return this rank's points (n, 3) and what is kept there, (n, k)."""
        columns = [column for law in self._augmented for column in law.history()]
        columns += [friction.slip.reshape(-1, 3) for friction in self._frictions]
        points = self.surface.X.reshape(-1, 3)
        return (points, np.hstack(columns)) if columns else (points[:0], np.empty((0, 0)))

    def set_history(self, values: Array) -> None:
        """Set what is kept, in the order of `history`. Collective."""
        first = 0
        for law in self._augmented:
            law.kept[:] = values[:, first].reshape(law.kept.shape)
            factor = float(values[:, first + 1].max(initial=1.0))
            law.kept_factor = self.comm.allreduce(factor, op=MPI.MAX)
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
