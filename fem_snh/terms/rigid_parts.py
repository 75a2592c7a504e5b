r"""Rigid parts of a body: six unknowns instead of the displacements of a part's nodes.

The state vector keeps the displacements of all nodes, so that all other terms evaluate the whole
body. Residuals, steps and the matrix have the six unknowns of a part at the entries of two of its
nodes, and zeros at its other nodes (`fem_snh.assembly.elimination`). In two dimensions the nodes
are points of a plane in space, and some of the six unknowns are not free. A step s ends on the
rigid motion :math:`\exp(s[\omega]_\times)`, so the second derivative of the energy along the step
is

.. math:: B^T H B + \sum_i \tfrac12 (f_i r_i^T + r_i f_i^T) - (f_i \cdot r_i) I

with B the derivative of the nodes' displacements by the twist, H the Hessian, f = dE/du the forces
on the nodes, and r the nodes' positions relative to the part's point. The sum is the curvature of
rotations. For a filtered Hessian the negative eigenvalues of this curvature, a matrix of all parts,
become zero or their absolute value; then it and :math:`B^T H B` are positive semidefinite.

Twists and arrays (6 parts,) are those of `fem_snh.geometry.rigid_tree`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh._petsc import vector_like
from fem_snh.arrays import Array
from fem_snh.assembly.assembled_matrix import BlockMatrix
from fem_snh.assembly.boundary_conditions import Dirichlet, axis_nodes
from fem_snh.assembly.elimination import Elimination
from fem_snh.assembly.nodal_mass import NodalMass
from fem_snh.assembly.regions import cells_of_one_label
from fem_snh.assembly.unknowns import nodes_of_other_cells, owned_sums, with_ghosts
from fem_snh.errors import bad_value
from fem_snh.geometry.rigid_tree import UNKNOWNS, Link, Poses, RigidTree, fit_poses, rotation_vector
from fem_snh.geometry.rotations import exponential, inverse_left_jacobian, skew
from fem_snh.terms.body import Body
from fem_snh.terms.rigid import Rigid, check_motions
from fem_snh.terms.rigid_loads import PrescribedMotions, RigidLoads
from fem_snh.terms.rigid_nodes import locate_parts
from fem_snh.terms.term import Term

#: Smallest radius of gyration of a part's nodes over the root sum of squares of all: below it the
#: nodes are on a line, about which the rotation is undetermined.
_ON_A_LINE = 1e-6
#: Loads at which prescribed motions are sampled for `Dirichlet.part_motions`.
_LOADS = (0.25, 0.5, 1.0)


class RigidParts(Term):
    """The rigid parts of a body, with their loads, springs and joints. Collective.

    Parameters
    ----------
    parts : sequence of Rigid
        The parts.
    body : Body
        The body.

    Attributes
    ----------
    names : list of str
        The parts' names.
    cells : (n,) int
        This rank's own cells whose nodes all belong to one part.
    shapes : dict of Shape
        The shapes, by the part's number; parts that are groups are left out.
    nodes : (n,) int
        This rank's own nodes of the parts.
    labels : (n,) int
        The part of each of these nodes.
    dofs : (n, components) int
        The displacement dofs of these nodes.
    tree : RigidTree
        The joints between the parts.
    moves : bool
        Whether any motion is prescribed.

    Raises
    ------
    BadInput
        On every rank: for a motion that the kinematics lacks, for a part whose nodes do not
        determine a rotation, for a node of two parts, and for constrained nodes inside of a part.
    """

    name, eliminates = "rigid", True

    def __init__(self, parts: Sequence[Rigid], body: Body) -> None:
        V, self._parts = body.V, list(parts)
        self._V = V
        self._comm: MPI.Comm = V.mesh.comm
        self.names = [part.label for part in parts]
        owned = _dolfinx.num_nodes(V)[0]
        self._kinematics = body.kinematics
        #: Which components of a twist the kinematics has, (6,); below, of a translation, (3,).
        self._admitted = np.array(body.kinematics.rigid_motions)
        self._translations = self._admitted[:3]
        for part in parts:
            check_motions(part, body.kinematics)
        local, points, self.shapes = locate_parts(parts, body)
        self.nodes = np.flatnonzero(local[:owned] >= 0)
        components = body.kinematics.components
        self.dofs = components * self.nodes[:, None] + np.arange(components)
        self.labels = local[self.nodes]
        self.cells = cells_of_one_label(V, local)
        self._release(V, local, body.dirichlet)
        self._X = V.tabulate_dof_coordinates()[self.nodes]
        self._counts = self._sum(np.ones((len(self.nodes), 1)))
        self._means = self._sum(self._X) / self._counts * self._translations
        self._centred = self._X - self._means[self.labels]
        self._squares = self._sum(_products(self._centred, self._centred))
        radii = self._radii(self._squares.reshape(-1, 3, 3))
        points = points * self._translations
        links = [self._link(i, radii[i], points[i]) for i in range(len(parts))]
        self.tree = RigidTree(links)
        self._rest = Poses(self.tree.points, np.tile(np.eye(3), (len(parts), 1, 1)))
        self._jointed = np.repeat([bool(link.joint) for link in self.tree.links], UNKNOWNS)
        self._offsets = self._X - self.tree.points[self.labels]
        self._slots = self._choose_slots(_dolfinx.local_to_global(V))
        self._elimination: Elimination | None = None
        self._motions = PrescribedMotions(parts, self.tree, body.amplitudes)
        self._loads = RigidLoads(parts, self.tree, body.amplitudes)
        self.has_energy, self.moves = self._loads.has_energy, self._motions.move
        self.symmetric = self.has_energy
        body.dirichlet.part_motions = self._motions_at_rest()
        self.depends_on_load = self.moves or self._loads.act
        self.set_load(0.0)
        for part in parts:
            if part.mass:
                self._add_mass(body, part)

    # --- the parts -------------------------------------------------------------------------------

    def _add_mass(self, body: Body, part: Rigid) -> None:
        """Add a part's own mass to the mass matrix, uniform over its surface. Collective.

        Raises BadInput without motion in time, and for a part that is no surface.
        """
        if body.motion is None:
            raise bad_value("rigid.mass", part.mass, "no value, without [time]")
        surface = part.group is not None
        if surface:
            dim = body.entities("rigid.group", part.group)[0]
            surface = dim < body.domain.topology.dim
        if not surface:
            accepted = "no value for a shape or a group of cells: their material has the density"
            raise bad_value("rigid.mass", part.mass, accepted)
        V, weights = body.V, _dolfinx.create_vector(body.V)
        measure = body.measure("rigid.group", part.group)
        form = _dolfinx.form(ufl.TestFunction(V)[0] * measure)
        _dolfinx.assemble_vector(weights, form)
        nodal = weights.array_r.reshape(-1, self._kinematics.components)[:, 0]
        body.motion.mass.add_points(nodal * (part.mass / self._comm.allreduce(nodal.sum())))

    def _release(self, V: _dolfinx.FunctionSpace, local: Array, dirichlet: Dirichlet) -> None:
        """Release constrained nodes on the parts' surfaces, as parts override conditions.

        Raises
        ------
        BadInput
            On every rank, for constrained nodes inside of a part, a part with constrained nodes
            only, or nodes in inclined planes of symmetry.
        """
        owned = _dolfinx.num_nodes(V)[0]
        on_planes = bool(dirichlet.planes and (local[dirichlet.planes.nodes] >= 0).any())
        if self._comm.allreduce(on_planes, op=MPI.LOR):
            accepted = "a part without nodes in planes of symmetry that are inclined"
            raise bad_value("rigid.group", self.names[0], accepted)
        inside = ~nodes_of_other_cells(V, self.cells)[self.nodes]
        constrained = dirichlet.constrained[:owned][self.nodes]
        if self._kinematics.revolved:  # parts do not leave the axis, either
            on_axis = np.isin(self.nodes, axis_nodes(V))
            for component in self._kinematics.off_axis:
                constrained[on_axis, component] = False
        fixed = constrained.any(axis=1)
        counts = np.stack([inside & fixed, fixed, np.ones_like(fixed)], axis=1).astype(float)
        for part, (within, given, every) in zip(self._parts, self._sum(counts), strict=True):
            if within or given == every:
                accepted = "a part without constrained nodes inside of it (its own keys "
                accepted += "'translate', 'rotate' and 'free' constrain it)"
                raise bad_value(part.where, part.label, accepted)
        dirichlet.release(local)

    def _radii(self, squares: Array) -> Array:
        """Return the root mean square distance [m] of the nodes from their mean, (parts,).

        ``squares`` (parts, 3, 3) are the sums of (X - mean X)(X - mean X)^T. Raises BadInput for
        nodes on a line.
        """
        traces = np.trace(squares, axis1=1, axis2=2)
        about = self._admitted[3:]
        inertia = (traces[:, None, None] * np.eye(3) - squares)[:, about][:, :, about]
        for part, moments, trace in zip(self._parts, inertia, traces, strict=True):
            if not np.linalg.eigvalsh(moments).min(initial=1.0) > _ON_A_LINE**2 * trace:
                accepted = "a part with three nodes that are not on a line"
                if self._kinematics.revolved:
                    accepted = "a part with a node that is not on the axis"
                raise bad_value(part.where, part.label, accepted)
        return np.asarray(np.sqrt(np.where(traces > 0, traces, 1.0) / self._counts[:, 0]))

    def _link(self, number: int, radius: float, middle: Array) -> Link:
        """Return the joint, or the free motions, of a part; ``radius`` [m] scales rotations."""
        part, joint = self._parts[number], self._parts[number].joint
        admitted = self._kinematics.rigid_motions
        if joint is None:
            point = middle if part.about is None else np.array(part.about)
            return Link(point, radius, free=part.free_motions, motions=admitted)
        axis = np.zeros(3)
        if joint.axis:
            axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        parent = self.names.index(joint.to) if joint.to else -1
        point = np.array(joint.through)
        return Link(point, radius, joint.kind, axis, parent, motions=admitted)

    def _motions_at_rest(self) -> list[Array]:
        """Return `Dirichlet.part_motions`: free motions, then the prescribed ones at `_LOADS`."""
        tree, size = self.tree, len(self._parts)
        lengths = np.repeat([link.length for link in tree.links], 3).reshape(size, 3)
        moves = [self._motions.at(load) for load in _LOADS]
        prescribed = [np.hstack([v, w * lengths]).ravel() * ~tree.free for v, w in moves]
        G = tree.jacobian(self._rest)
        twists = np.concatenate([G[:, tree.free].T, np.array(prescribed) @ G.T])
        twists = twists.reshape(-1, size, 2, 3).swapaxes(0, 1).copy()
        twists[:, :, 0] -= np.cross(twists[:, :, 1], tree.points[:, None])
        return list(twists)

    def _choose_slots(self, to_global: Array) -> Array:
        """Return the two smallest global node numbers of each part, (parts, 2). Collective."""
        own = to_global[self.nodes]
        parts = range(len(self._parts))
        least = [np.sort(own[self.labels == i])[:2] for i in parts]
        every = self._comm.allgather(least)
        return np.array([np.sort(np.concatenate([e[i] for e in every]))[:2] for i in parts])

    def eliminate(self, matrix: BlockMatrix) -> Array:
        """Let a problem's matrix eliminate the parts' nodes from now on. Collective.

        Return the entries of this rank's vectors that are no unknowns, (m,).
        """
        chains = [self.tree.ancestors(i) for i in range(len(self._parts))]
        parts = self.nodes, self.labels, self._slots, self.tree.free, chains
        self._elimination = matrix.eliminate(lambda dof_map: Elimination(dof_map, *parts))
        return self._elimination.eliminated

    # --- poses -----------------------------------------------------------------------------------

    def _sum(self, values: Array) -> Array:
        """Return the sums (parts, columns) of values (nodes, columns) on all ranks. Collective."""
        sums = np.zeros((len(self._parts), values.shape[1]))
        np.add.at(sums, self.labels, values)
        return np.asarray(self._comm.allreduce(sums))

    def poses(self, x: PETSc.Vec) -> Poses:
        """Return the poses nearest to the displacements in ``x``, in least squares. Collective."""
        u = self._nodal(x)
        sums = self._sum(np.hstack([u, _products(u, self._centred)]))
        products = (sums[:, 3:] + self._squares).reshape(-1, 3, 3)
        places = self._means + sums[:, :3] / self._counts * self._translations
        return fit_poses(self.tree.links, self._means, places, products)

    def _nodal(self, x: PETSc.Vec) -> Array:
        """Return the parts' nodal rows of ``x`` as vectors, (nodes, 3), padded by zeros."""
        return self._kinematics.padded(x.array_r[self.dofs])

    def _components(self, vectors: Array) -> Array:
        """Return the components of vectors (nodes, 3, ...) that a displacement has."""
        return vectors[:, : self._kinematics.components]

    def _set_poses(self, x: PETSc.Vec, poses: Poses) -> None:
        """Set the displacements of the parts' own nodes in ``x`` to the motions of poses."""
        moved = poses.c[self.labels] + self._arms(poses) - self._X
        x.array[self.dofs] = self._components(moved)

    def _arms(self, poses: Poses) -> Array:
        """Return the nodes' positions at poses relative to their part's point, (nodes, 3) [m]."""
        return np.asarray(np.einsum("nij,nj->ni", poses.R[self.labels], self._offsets))

    def _basis(self, poses: Poses) -> Array:
        """Return the derivative of the nodes' positions by their part's twist, (n, c, 6)."""
        basis = np.zeros((len(self.nodes), 3, UNKNOWNS))
        basis[:, :, :3], basis[:, :, 3:] = np.eye(3), -skew(self._arms(poses))
        return self._components(basis)

    def prescribe(self, x: PETSc.Vec, load: float, poses: Poses | None = None) -> None:
        """Move the parts' nodes in ``x`` to poses admissible at a load. Collective.

        `RigidTree.project` finds them from ``poses``, by default the poses of ``x``.
        """
        translations, vectors = self._motions.at(load)
        rotations = np.array([exponential(vector) for vector in vectors])
        self._set_poses(x, self.tree.project(poses or self.poses(x), translations, rotations))

    @property
    def prescribed_parts(self) -> Array:
        """The numbers of the parts whose motion is wholly prescribed, (n,)."""
        fixed = ~(self.tree.free | self._jointed).reshape(-1, UNKNOWNS)
        return np.flatnonzero(fixed.all(axis=1))

    def prescribed_displacement(self, load: float) -> Array:
        """Return the displacements of this rank's own nodes of `prescribed_parts`, (dofs,) [m]."""
        translations, vectors = self._motions.at(load)
        rotations = np.array([exponential(vector) for vector in vectors])
        poses = Poses(self.tree.points + translations, rotations)
        moved = self._components(poses.c[self.labels] + self._arms(poses) - self._X)
        return np.asarray(moved[np.isin(self.labels, self.prescribed_parts)].ravel())

    def move(self, x: PETSc.Vec, d: PETSc.Vec, step: float, end: PETSc.Vec) -> None:
        """Set the parts' nodes in ``end`` to the end of the path from x along ``step * d``.

        ``d`` has the increments of the unknowns at their entries. Collective.
        """
        poses = self.poses(x)
        self._set_poses(end, self.tree.move(poses, step * self._unknowns(d)))

    def move_rigidly(self, x: PETSc.Vec) -> None:
        """Move the parts' nodes in ``x`` to poses admissible at the present load. Collective."""
        self.prescribe(x, self._load)

    def _unknowns(self, d: PETSc.Vec) -> Array:
        """Return the parts' unknowns in a vector, (6 parts,), 0 if not free. Collective."""
        assert self._elimination is not None
        entries, which = self._elimination.own_unknowns
        found = np.zeros(UNKNOWNS * len(self._parts))
        found[which] = d.array_r[entries]
        return np.where(self.tree.free, self._comm.allreduce(found), 0.0)

    # --- forces ----------------------------------------------------------------------------------

    def set_load(self, load: float) -> None:
        """Set the load parameter."""
        self._load = load
        self._loads.set_load(load)

    def energy(self, u: PETSc.Vec, p: PETSc.Vec | None = None) -> float:
        """Return the energy of loads and springs [J]: see `RigidLoads.energy`. Collective."""
        return self._loads.energy(self.poses(u))

    def force_norms(self, x: PETSc.Vec) -> tuple[float, float, float]:
        """Return three norms [N]: of loads, of joints' drives, and of springs. Collective.

        Each is the 2-norm of the generalised forces on the unknowns of all parts, prescribed ones
        included. Moments are divided by ``Link.length``.
        """
        poses = self.poses(x)
        acting = np.stack([self._loads.loads(poses), self._loads.springs(poses)])
        loads, springs = np.linalg.norm(acting @ self.tree.jacobian(poses), axis=1)
        return float(loads), float(np.linalg.norm(self._loads.drive)), float(springs)

    def add_residual(
        self, u: PETSc.Vec, p: PETSc.Vec | None, r_u: PETSc.Vec, r_p: PETSc.Vec | None
    ) -> None:
        """Do nothing: `reduce` adds loads, springs and drives to the forces on the unknowns."""

    def add_hessian(
        self, u: PETSc.Vec, p: PETSc.Vec | None, filter: str, target: BlockMatrix
    ) -> int:
        """Add nothing; return the number of eigenvalues that `prepare` filtered, on rank 0 only."""
        return self._filtered if self._comm.rank == 0 else 0

    def wrenches(self, poses: Poses, gradient: PETSc.Vec) -> Array:
        """Return the sums of nodal forces [N] and of their moments [N m], (6 parts,). Collective.

        The forces are ``gradient`` = dE/du. Moments are about the parts' points.
        """
        f = self._nodal(gradient)
        moments = np.cross(self._arms(poses), f)
        return np.asarray(self._sum(np.hstack([f, moments])) * self._admitted).ravel()

    def reduce(self, x: PETSc.Vec, r: PETSc.Vec) -> None:
        """Replace forces on the parts' nodes in ``r`` by forces on the unknowns. Collective.

        Loads, springs and drives are added.
        """
        poses = self.poses(x)
        forces = self.wrenches(poses, r) + self._loads.acting(poses)
        self._set_unknowns(r, self.tree.jacobian(poses).T @ forces - self._loads.drive)

    def reduce_vector(self, x: PETSc.Vec, g: PETSc.Vec) -> None:
        """Replace the derivatives by the parts' displacements in ``g`` by derivatives by unknowns.

        Unlike `reduce`, it adds no loads. Collective.
        """
        poses = self.poses(x)
        self._set_unknowns(g, self.tree.jacobian(poses).T @ self.wrenches(poses, g))

    def _set_unknowns(self, r: PETSc.Vec, values: Array) -> None:
        """Set the entries of parts' nodes in ``r`` to zero, but free unknowns to ``values``."""
        assert self._elimination is not None
        entries, which = self._elimination.own_unknowns
        own = r.array
        own[self.dofs] = 0.0
        own[entries] = np.where(self.tree.free, values, 0.0)[which]

    def prepare(self, x: PETSc.Vec, gradient: PETSc.Vec, filter: str, whole: bool = False) -> None:
        """Set the state of the elimination for the Hessian at x. Collective.

        ``gradient`` is dE/du at x. `fem_snh.terms.term.Term.add_hessian` describes ``filter``. With
        ``whole``, an exact Hessian has the asymmetric part `RigidLoads.turning`.
        """
        assert self._elimination is not None
        poses, tree = self.poses(x), self.tree
        G, arms = tree.jacobian(poses), self._arms(poses)
        f = self._nodal(gradient)
        products = self._sum(_products(f, arms)).reshape(-1, 3, 3)
        acting = self._loads.acting(poses)
        wrenches = self.wrenches(poses, gradient) + acting
        K = tree.curvature(poses, G, wrenches, products)
        K += G.T @ self._loads.spring_matrix(poses) @ G
        whole = whole and filter == "exact"
        if whole:
            K += G.T @ self._loads.turning(poses, self.wrenches(poses, gradient)) @ G
        K *= np.outer(tree.free, tree.free)
        self._filtered = 0
        if filter != "exact":
            values, vectors = np.linalg.eigh(K)
            self._filtered = int((values < 0).sum())
            values = np.abs(values) if filter == "abs" else np.maximum(values, 0.0)
            K = (vectors * values) @ vectors.T
        self._elimination.set_state(self._basis(poses).reshape(-1, UNKNOWNS), G, K, not whole)

    # --- goals of error estimates ----------------------------------------------------------------

    def place(self, part: str) -> Array:
        """Return the reference coordinates [m] of the point of the part named ``part``, (3,)."""
        return self.tree.points[self.names.index(part)]

    def velocity(self, x: PETSc.Vec, part: str, twist: Array) -> PETSc.Vec:
        """Return the velocities of a part's nodes at ``x``, zero elsewhere. Collective.

        ``twist`` (6,) is (v, omega) in fixed axes: the velocity of the part's point and the angular
        velocity.
        """
        found, basis = vector_like(x), self._basis(self.poses(x))
        own = self.labels == self.names.index(part)
        found.array[self.dofs[own]] = basis[own] @ twist
        return found

    def derivative_of_pose(self, x: PETSc.Vec, part: str, kind: str, component: int) -> PETSc.Vec:
        """Return the derivative of a part's "displacement" or "rotation" by nodal displacements.

        Only its products with rigid motions matter: it has minimum norm. Collective.
        """
        wrench = np.zeros(UNKNOWNS)
        if kind == "displacement":
            wrench[component] = 1.0
        else:
            theta = rotation_vector(self.poses(x).R[self.names.index(part)])
            wrench[3:] = inverse_left_jacobian(theta)[component]
        return self._spread(x, part, wrench)

    def derivative_of_arms(
        self, x: PETSc.Vec, part: str, gradient: PETSc.Vec, axis: int
    ) -> PETSc.Vec:
        """Return the derivative of a part's moment by nodal displacements, forces constant.

        The moment of the forces ``gradient`` is about ``axis`` (0, 1 or 2) through the part's
        point. The result has minimum norm. Collective.
        """
        poses, f = self.poses(x), self._nodal(gradient)
        moments = np.cross(self._arms(poses), np.cross(f, np.eye(3)[axis]))
        wrench = np.zeros(UNKNOWNS)
        wrench[3:] = self._sum(moments)[self.names.index(part)] * self._admitted[3:]
        return self._spread(x, part, wrench)

    def _spread(self, x: PETSc.Vec, part: str, wrench: Array) -> PETSc.Vec:
        """Return the nodal forces of minimum norm whose force and moment are ``wrench`` (6,).

        They act on the nodes of ``part``. Collective.
        """
        number = self.names.index(part)
        basis = self._basis(self.poses(x)) * self._admitted
        pairs = np.einsum("nij,nik->njk", basis, basis)
        products = self._sum(pairs.reshape(-1, UNKNOWNS**2))[number].reshape(UNKNOWNS, UNKNOWNS)
        return self.velocity(x, part, np.linalg.pinv(products, hermitian=True) @ wrench)

    # --- rigid motions of the body ----------------------------------------------------------------

    def twists(self, owners: Array, origin: Array, length: float, count: int) -> Array:
        """Return the parts' twists in rigid motions of the body, (6 parts, 6 count). Collective.

        Parameters
        ----------
        owners : (owned nodes,) int
            The number of each node's component, a connected part of the body.
        origin : (3,) array
            The origin [m] of the motions t length + omega x (X - origin).
        length : float
            The length [m] in them.
        count : int
            The number of components. Six columns for each hold unit t, then unit omega.
        """
        number = len(self._parts)
        local = np.full(number, -1)
        local[self.labels] = owners[self.nodes]
        found = np.zeros((number, UNKNOWNS, count, UNKNOWNS))
        for i, owner in enumerate(np.max(self._comm.allgather(local), axis=0)):
            found[i, :3, owner, :3], found[i, 3:, owner, 3:] = length * np.eye(3), np.eye(3)
            found[i, :3, owner, 3:] = -skew(self.tree.points[i] - origin)
        return found.reshape(UNKNOWNS * number, -1)

    def inadmissible(self, twists: Array) -> Array:
        """Return the part of twists (6 parts, n) at rest that conditions and joints do not admit.

        It is (6 parts, n) [m]; rotations are multiplied by ``Link.length``.
        """
        lengths = np.repeat([[1.0, link.length] for link in self.tree.links], 3)[:, None]
        scaled = lengths * twists
        basis = np.linalg.qr((lengths * self.tree.jacobian(self._rest))[:, self.tree.free])[0]
        return np.asarray(scaled - basis @ (basis.T @ scaled))

    def stiffness_at_rest(self, twists: Array) -> Array:
        """Return the second derivative of the springs' energy along twists at rest, (n, n).

        ``twists`` is (6 parts, n).
        """
        return np.asarray(twists.T @ self._loads.spring_matrix(self._rest) @ twists)

    def work_at_rest(self, twist: Array) -> Array:
        """Return minus the work of loads and drives along an admissible twist (6 parts,) at rest.

        The result has one entry for each component of a load, then of a drive, (12 parts,).
        """
        G = self.tree.jacobian(self._rest) * self.tree.free
        unknowns = np.linalg.lstsq(G, twist, rcond=None)[0]
        works = [self._loads.loads(self._rest) * twist, -self._loads.drive * unknowns]
        return np.concatenate(works)

    # --- motion in time --------------------------------------------------------------------------

    def prepare_mass(self, x: PETSc.Vec) -> None:
        """Set the state of the elimination for a mass matrix at x. Collective."""
        assert self._elimination is not None
        poses = self.poses(x)
        G = self.tree.jacobian(poses)
        basis = self._basis(poses).reshape(-1, UNKNOWNS)
        self._elimination.set_state(basis, G, np.zeros_like(G))

    def _derivative(self, poses: Poses, G: Array) -> Array:
        """Return the derivative of nodes' positions by unknowns, (nodes, components, 6 parts)."""
        of_parts = G.reshape(-1, UNKNOWNS, len(G))[self.labels]
        return np.asarray(np.einsum("nij,njk->nik", self._basis(poses), of_parts))

    def expand(self, x: PETSc.Vec, values: Array) -> None:
        """Replace unknowns in ``values`` (owned dofs,) by nodal displacements. Collective."""
        poses, d = self.poses(x), vector_like(x, values)
        twists = (self.tree.jacobian(poses) @ self._unknowns(d)).reshape(-1, UNKNOWNS)
        moved = np.einsum("nik,nk->ni", self._basis(poses), twists[self.labels])
        values[self.dofs] = moved

    def _set_nodes(self, values: Array, nodal: Array) -> None:
        """Set the parts' nodes in ``values`` (local dofs,), ghosts included. Collective.

        ``nodal`` (nodes, components) has the values of this rank's own nodes.
        """
        values[self.dofs] = nodal
        owned = self._kinematics.components * _dolfinx.num_nodes(self._V)[0]
        values[:] = with_ghosts(self._V, values[:owned])

    def make_rigid(
        self, x: PETSc.Vec, mass: NodalMass, step: float, v: Array, a: Array | None = None
    ) -> Array:
        """Project velocity and acceleration of the parts' nodes on rigid motions. Collective.

        The momenta of free unknowns do not change. The acceleration gets the centripetal part,
        which a time integrator's formulas lack.

        Parameters
        ----------
        x : PETSc.Vec
            The displacement.
        mass : NodalMass
            The mass matrix.
        step : float
            As for `path_rates`.
        v : (local dofs,)
            Velocity [m/s], ghosts included; changed in place.
        a : (local dofs,), optional
            Acceleration [m/s^2], likewise.

        Returns
        -------
        (nodes, components)
            The centripetal and the prescribed part of the acceleration.
        """
        poses, tree = self.poses(x), self.tree
        G = tree.jacobian(poses)
        moved = self._derivative(poses, G)
        C = np.where(tree.free, moved, 0.0)

        def reduced(nodal: Array) -> Array:
            """Return C^T M w of nodal vectors w (nodes, components), (6 parts,). Collective."""
            own = np.zeros(mass.num_owned)
            own[self.dofs] = nodal
            f = owned_sums(self._V, mass.apply(with_ghosts(self._V, own)))[self.dofs]
            return np.asarray(self._comm.allreduce(np.einsum("nik,ni->k", C, f)))

        M = np.stack([reduced(C[:, :, k]) for k in range(len(G))], axis=1)
        M += np.diag(np.where(tree.free, 0.0, 1.0))

        fixed = ~(tree.free | self._jointed)
        first, second = (
            np.where(fixed, rates.ravel(), 0.0) for rates in self._motions.rates(self._load, step)
        )
        rates = first + np.linalg.solve(M, reduced(v[self.dofs] - moved @ first))
        self._set_nodes(v, moved @ rates)
        bias = tree.accelerations(poses, G, rates)[self.labels]
        omega, arms = (G @ rates).reshape(-1, 2, 3)[self.labels, 1], self._arms(poses)
        turning = bias[:, 0] + np.cross(bias[:, 1], arms) + np.cross(omega, np.cross(omega, arms))
        turning = self._components(turning) + moved @ second
        if a is None:
            return turning
        self._set_nodes(a, turning + moved @ np.linalg.solve(M, reduced(a[self.dofs] - turning)))
        return turning

    def states(self, x: PETSc.Vec, gradient: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return the rows of run.json by the parts' names. Collective.

        A row has the "position" [m] of the part's point, the point's "displacement" [m], the
        "rotation", a rotation vector [rad], and the "force" [N] and "moment" [N m] about the point:
        the sums of ``gradient`` = dE/du, which loads, springs, joints and prescribed motions exert.
        """
        poses = self.poses(x)
        forces = self.wrenches(poses, gradient).reshape(-1, 2, 3)
        return {
            name: {
                "position": poses.c[i].tolist(),
                "displacement": (poses.c[i] - self.tree.points[i]).tolist(),
                "rotation": rotation_vector(poses.R[i]).tolist(),
                "force": forces[i, 0].tolist(),
                "moment": forces[i, 1].tolist(),
            }
            for i, name in enumerate(self.names)
        }


def _products(a: Array, b: Array) -> Array:
    """Return the outer products a b^T of vectors (n, 3), row by row, (n, 9)."""
    return np.asarray((a[:, :, None] * b[:, None]).reshape(-1, 9))
