"""Dirichlet conditions: which displacement components are constrained, and their values."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.assembly.inclined_planes import InclinedPlanes, NodePlane, plane_through
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.errors import bad_value
from fem_snh.mesh.mesh import DIMENSIONS, Mesh
from fem_snh.mesh.mesh_checks import ON_AXIS

Array = npt.NDArray[Any]

AXES = ("x", "y", "z")
#: Loads at which the values of two conditions are compared, and their largest difference, relative
#: to the values, that is rounding.
_LOADS, _ROUNDING = (0.25, 0.5, 1.0), 1e-9
#: Sine of the angle below which two constrained directions are the same, as those of planes.
_DEPENDENT = 1e-7


class Constraint(Protocol):
    """Components of the displacement on a physical group that are zero."""

    @property
    def group(self) -> str | int:
        """Name or number of the physical group."""

    @property
    def components(self) -> Sequence[str]:
        """The constrained components, among "x", "y" and "z"."""


class PrescribedDisplacement(Constraint, Protocol):
    """Components of the displacement on a physical group that follow the load."""

    def displacement(self, X: Array, load: float) -> Array:
        """Return the (n, 3) displacement [m] of reference points X (n, 3) at a load of 0 to 1."""


class SymmetryPlane(Protocol):
    """A plane physical group whose nodes slide in its plane."""

    @property
    def group(self) -> Any:
        """Name or number of the physical group."""


class NodalMotion(Protocol):
    """The displacement of some nodes, in all components, as a function of the load."""

    @property
    def nodes(self) -> Array:
        """The local nodes, ghosts included."""

    @property
    def moves(self) -> bool:
        """Whether the displacement is not zero."""

    def displacement(self, X: Array, load: float) -> Array:
        """Return the (n, 3) displacement [m] of reference points X (n, 3) at a load of 0 to 1."""


class Condition(NamedTuple):
    """The directions that one condition constrains.

    Attributes
    ----------
    label : str
        The label of its physical group; "bones" for all bones; of a program ``bcs[number]``.
    directions : sequence of ((n,) int, (components,) array)
        Local nodes, ghosts included, and the direction that is constrained there.
    """

    label: str
    directions: Sequence[tuple[Array, Array]]

    @classmethod
    def of_axes(cls, label: str, nodes: Array, axes: Sequence[int], components: int) -> Condition:
        """Return the condition on some components of nodes."""
        return cls(label, [(nodes, np.eye(components)[axis]) for axis in axes])


class Dirichlet:
    """The constrained directions of a displacement space and their values.

    Attributes
    ----------
    constrained : (local nodes, components) bool
        Which components of which nodes, ghosts included, are constrained.
    dofs : (n,) int
        The constrained dofs this rank owns, as indices into a vector's local array.
    planes : InclinedPlanes or None
        The nodes with a constrained direction that is no component.
    depends_on_load : bool
        Whether any value depends on the load.
    by_hand : bool
        Whether values are a program's own, which it may change from step to step.
    released : (n,) int
        Dofs of this rank that other unknowns move: `set_values` may set them, to no effect.
    rigid_parts : (local nodes,) int or None
        The rigid part of each node, -1: none. None if the body has no rigid parts.
    part_motions : sequence of (n, 2, 3)
        The motions of each part that its conditions admit or prescribe at rest: velocities of a
        point at the origin, and angular velocities.
    solid_cells : (n,) int
        This rank's own cells whose nodes are constrained and that are not assembled.
    thin : ThinSupports or None
        What is constrained at points, in three dimensions also at edges, and by no surface.
    conditions : sequence of Condition
        What each condition constrains; at common nodes a later one overrides an earlier one.
    """

    constrained: Array
    dofs: Array
    planes: InclinedPlanes | None = None
    depends_on_load: bool
    by_hand: bool = False
    released: Array = np.empty(0, np.int64)
    rigid_parts: Array | None = None
    part_motions: Sequence[Array] = ()
    solid_cells: Array = np.empty(0, np.int64)
    thin: ThinSupports | None = None
    conditions: Sequence[Condition] = ()

    def release(self, parts: Array) -> None:
        """Constrain no component of the nodes of rigid parts, (local nodes,) int >= 0."""
        before, self.rigid_parts = self.dofs, parts
        self.constrained[parts >= 0] = False
        owned = int(before[-1]) // self.constrained.shape[1] + 1 if len(before) else 0
        self.dofs = np.flatnonzero(self.constrained[:owned])
        self.released = np.setdiff1d(before, self.dofs)

    def set_load(self, load: float) -> None:
        """Set constants and functions of a program, which conditions and terms may have."""

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set what is constrained of ``x`` to its values at this load."""
        raise NotImplementedError(f"{type(self).__name__}.set_values")

    def project(self, values: Array, ghosts: bool = False) -> None:
        """Set what is constrained of displacements or forces to zero, in place.

        ``values`` begins with the components of this rank's nodes, with ``ghosts`` of all local
        nodes.
        """
        values[self.constrained.ravel() if ghosts else self.dofs] = 0.0
        if self.planes:
            self.planes.project(values, ghosts)

    def thin_supports(self) -> ThinSupports | None:
        """Return what points and edges alone constrain; None without any. Collective."""
        return self.thin

    def contradictions_of_values(self) -> list[str]:
        """Return a line for each pair of conditions that differ at common nodes. Collective."""
        return []

    def work(self, forces: Array, moved: Array) -> float:
        """Return the work of forces [N] along constrained displacements of this rank's nodes."""
        found = float(forces[self.dofs] @ moved[self.dofs])
        return found + (self.planes.work(forces, moved) if self.planes else 0.0)

    @property
    def constrained_nodes(self) -> Array:
        """(local nodes,) bool: which nodes have a constrained direction."""
        found: Array = np.any(self.constrained, axis=1)
        if self.planes:
            found[self.planes.nodes] = True
        return found


class ThinSupports(NamedTuple):
    """Conditions at points, in three dimensions also at edges: they have no area.

    Attributes
    ----------
    text : str
        The conditions, "[[hold]] of 'corner'".
    dofs : (n,) int
        The dofs that they alone constrain, of this rank's own nodes.
    """

    text: str
    dofs: Array


@dataclass
class StartPath:
    """The path of the constrained dofs from a start to the conditions.

    Attributes
    ----------
    offset : (n,) array or None
        Their values at the start minus those of the conditions at load 0, which decrease to zero
        in proportion to the load; None before the start is known.
    """

    offset: Array | None = None


class DirichletConditions(Dirichlet):
    """Dirichlet conditions on physical groups, with the attributes of `Dirichlet`. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh
        The mesh whose physical groups the conditions name.
    hold : sequence of Constraint
        Zero displacement.
    move : sequence of PrescribedDisplacement
        Displacement that follows the load. At nodes that groups have in common, as on the edge of
        two faces, a later condition overrides an earlier one, and any of ``move`` overrides
        ``hold``.
    bones : sequence of NodalMotion, optional
        Displacements of nodes, different ones, which override all others.
    symmetry : sequence of SymmetryPlane, optional
        Planes in which nodes slide. Conditions prescribe no displacement out of them.
    kinematics : Kinematics, optional
        Conditions have the components that it has. On a body of revolution the radial and
        rotational displacements are zero on the axis, whatever else is prescribed there.

    Attributes
    ----------
    path : StartPath or None
        The path from the state of another run; problems of one scene share it.
    contradictions : list of str
        A line for each pair of conditions with different values at some common nodes.

    Raises
    ------
    BadInput
        On every rank, for an unknown physical group, for a condition that a later one with other
        values overrides at all of its nodes, and for a `symmetry` that is not plane, or that nodes
        leave.
    """

    def __init__(
        self,
        V: Any,
        mesh: Mesh,
        hold: Sequence[Constraint],
        move: Sequence[PrescribedDisplacement],
        bones: Sequence[NodalMotion] = (),
        kinematics: Kinematics = SOLID,
        symmetry: Sequence[SymmetryPlane] = (),
    ) -> None:
        owned, ghosts = _dolfinx.num_nodes(V)
        self._kinematics, components = kinematics, kinematics.components
        self.constrained: Array = np.zeros((owned + ghosts, components), dtype=bool)
        self.bones = list(bones)
        self._moved: list[tuple[Array, list[int], PrescribedDisplacement | NodalMotion, Array]] = []
        #: Where the nodes of bones are in these, if not at their own reference coordinates.
        self._in_bones: dict[int, Array] = {}
        conditions: list[Condition] = []
        for condition in hold:
            conditions.append(self._constrain(V, mesh, condition)[0])
        coordinates = V.tabulate_dof_coordinates()
        for motion in move:
            made, nodes, axes = self._constrain(V, mesh, motion)
            conditions.append(made)
            nodes = nodes[nodes < owned]
            self._moved.append((nodes, axes, motion, coordinates[nodes]))
        self._check_overrides(V, mesh, hold, move)
        for bone in bones:
            self.constrained[bone.nodes] = True
            conditions.append(Condition.of_axes("bones", bone.nodes, range(3), components))
            nodes = bone.nodes[bone.nodes < owned]
            self._moved.append((nodes, [0, 1, 2], bone, coordinates[nodes]))
        self._on_axis: Array = np.empty(0, np.int64)
        if kinematics.revolved:
            nodes = axis_nodes(V)
            self.constrained[nodes[:, None], kinematics.off_axis] = True
            nodes = nodes[nodes < owned]
            self._on_axis = (components * nodes[:, None] + kinematics.off_axis).ravel()
        planes = [_plane_of_group(V, mesh, plane.group) for plane in symmetry]
        of_planes = [
            Condition(mesh.group(table.group).label, [(plane.nodes, plane.normal)])
            for table, plane in zip(symmetry, planes, strict=True)
        ]
        self.conditions = [*of_planes, *conditions]
        self.planes = InclinedPlanes.of(planes, self.constrained, owned)
        self.dofs = np.flatnonzero(self.constrained[:owned])
        self.depends_on_load = bool(move) or any(bone.moves for bone in bones)
        self.path: StartPath | None = None
        if planes:
            self._check_planes(V, planes, symmetry)
        self.thin = self._thin_supports(V, mesh, hold, move, planes)

    def _constrain(
        self, V: Any, mesh: Mesh, condition: Constraint
    ) -> tuple[Condition, Array, list[int]]:
        """Mark what a condition constrains; return it, its local nodes and its components."""
        nodes, axes = group_nodes(V, mesh, condition.group), self._axes(condition)
        self.constrained[nodes[:, None], axes] = True
        label, components = mesh.group(condition.group).label, self._kinematics.components
        return Condition.of_axes(label, nodes, axes, components), nodes, axes

    def _axes(self, condition: Constraint) -> list[int]:
        """Return the numbers of a condition's components; those of 3D alone are left out."""
        known = self._kinematics.axes
        axes = [known.index(c) for c in condition.components if c in known]
        if not axes:
            accepted = f"some of {', '.join(known)}, the components in {self._kinematics.name}"
            raise bad_value("components", list(condition.components), accepted)
        return axes

    def _check_overrides(
        self, V: Any, mesh: Mesh, hold: Sequence[Constraint], move: Sequence[PrescribedDisplacement]
    ) -> None:
        """Raise BadInput if a motion overrides an earlier condition at all nodes. Collective."""
        coordinates = V.tabulate_dof_coordinates()
        owned = _dolfinx.num_nodes(V)[0]
        self.contradictions: list[str] = []
        earlier: list[tuple[str, Constraint, Array, list[int]]] = []
        for condition in hold if self._moved else ():
            nodes = group_nodes(V, mesh, condition.group)
            axes = self._axes(condition)
            earlier.append(("hold", condition, nodes[nodes < owned], axes))
        for (nodes, axes, _, _), motion in zip(self._moved, move, strict=True):
            for table, other, others, other_axes in earlier:
                both = [axis for axis in axes if axis in other_axes]
                shared = np.intersect1d(nodes, others)
                X = coordinates[shared]
                different = np.zeros((len(shared), len(both)), dtype=bool)
                for load in _LOADS if both else ():
                    u = motion.displacement(X, load)[:, both]
                    before = _displacement(other, X, load)[:, both]
                    size = max(abs(u).max(initial=0.0), abs(before).max(initial=0.0))
                    different |= abs(u - before) > _ROUNDING * size
                at = different.any(axis=1)
                found = [len(shared), len(others), int(at.sum())]
                total, all_of_it, differs = V.mesh.comm.allreduce(np.array(found))
                if not differs:
                    continue
                if total == all_of_it:
                    listed = ", ".join(AXES[axis] for axis in both)
                    accepted = f"components other than {listed}, which [[{table}]] constrains at "
                    accepted += f"the same nodes by the group {other.group!r}"
                    raise bad_value("move.group", motion.group, accepted)
                least = _ROUNDING * abs(coordinates).max(initial=0.0)
                rows = np.where(abs(X[at]) > least, X[at], 0.0)
                gathered = V.mesh.comm.allgather((rows.tolist(), different.any(axis=0)))
                place = min(x for rows, _ in gathered for x in rows)
                differing = np.any([marks for _, marks in gathered], axis=0)
                pair = f"[[move]] of {motion.group!r} and [[{table}]] of {other.group!r}"
                listed = np.array(both)[differing].tolist()
                text = contradiction(pair, listed, differs, place, "that [[move]]")
                self.contradictions.append(text)
            earlier.append(("move", motion, nodes, axes))

    def contradictions_of_values(self) -> list[str]:
        """Return `contradictions`."""
        return self.contradictions

    def _thin_supports(
        self,
        V: Any,
        mesh: Mesh,
        hold: Sequence[Constraint],
        move: Sequence[PrescribedDisplacement],
        planes: Sequence[NodePlane],
    ) -> ThinSupports | None:
        """Return what points and edges alone constrain; None without any condition on them.

        The axis of revolution is an edge.
        """
        named = [("hold", condition) for condition in hold] + [("move", motion) for motion in move]
        axis = axis_nodes(V) if self._kinematics.revolved else np.empty(0, np.int64)

        def has_no_area(condition: Constraint) -> bool:
            if mesh.group(condition.group).dim < mesh.dim - 1 or not self._kinematics.revolved:
                return mesh.group(condition.group).dim < mesh.dim - 1
            off = np.setdiff1d(group_nodes(V, mesh, condition.group), axis)
            return bool(V.mesh.comm.allreduce(len(off)) == 0)

        thin = [pair for pair in named if has_no_area(pair[1])]
        if not thin:
            return None
        marked = np.zeros_like(self.constrained)
        for pair in (*thin, *(pair for pair in named if pair not in thin)):
            nodes = group_nodes(V, mesh, pair[1].group)
            marked[nodes[:, None], self._axes(pair[1])] = pair in thin
        for plane in planes:
            marked[np.ix_(plane.nodes, abs(plane.normal) > _ROUNDING)] = False
        for bone in self.bones:
            marked[bone.nodes] = False
        text = ", ".join(f"[[{table}]] of {condition.group!r}" for table, condition in thin)
        owned = _dolfinx.num_nodes(V)[0]
        return ThinSupports(text, np.setdiff1d(np.flatnonzero(marked[:owned]), self._on_axis))

    def _check_planes(
        self, V: Any, planes: Sequence[NodePlane], symmetry: Sequence[SymmetryPlane]
    ) -> None:
        """Raise BadInput if a motion takes nodes out of a plane of symmetry. Collective."""
        u = _dolfinx.create_vector(V)
        components, owned = self._kinematics.components, _dolfinx.num_nodes(V)[0]
        for load in _LOADS if self.depends_on_load else ():
            self.set_values(u, load)
            values = u.array_r.reshape(-1, components)
            for plane, table in zip(planes, symmetry, strict=True):
                moved = values[plane.nodes[plane.nodes < owned]] @ plane.normal
                sizes = np.array([abs(moved).max(initial=0.0), abs(values).max(initial=0.0)])
                V.mesh.comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
                if sizes[0] > _ROUNDING * sizes[1]:
                    accepted = "a plane that no [[move]] and no [[bone]] takes nodes out of"
                    raise bad_value("symmetry.group", table.group, accepted)

    def place_bone(self, number: int, points: Array) -> None:
        """Let this rank's own nodes of a bone be at other points of it, (n, 3) [length]."""
        self._in_bones[number] = points

    def share_path(self, path: StartPath) -> None:
        """Let the values go along a path, which problems of one scene share."""
        self.path, self.depends_on_load = path, True

    def start_from(self, x: PETSc.Vec) -> None:
        """Let the `path`, which has no offset yet, begin at the values of ``x``."""
        assert self.path is not None
        own = x.copy()
        self.set_values(own, 0.0)
        self.path.offset = x.array_r[self.dofs] - own.array_r[self.dofs]

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set what is constrained of ``x`` to its values at this load."""
        values, components = x.array, self._kinematics.components
        values[self.dofs] = 0.0
        first = len(self._moved) - len(self.bones)
        for number, (nodes, axes, motion, points) in enumerate(self._moved, -first):
            displacement = motion.displacement(self._in_bones.get(number, points), load)
            if number in self._in_bones:
                displacement = displacement + self._in_bones[number] - points
            values[components * nodes[:, None] + axes] = displacement[:, axes]
        values[self._on_axis] = 0.0
        if self.path is not None and self.path.offset is not None:
            values[self.dofs] += (1 - load) * self.path.offset
        if self.planes:
            self.planes.prescribe(values)


def contradiction(
    pair: str, axes: Sequence[int], count: int, place: Sequence[float], taken: str
) -> str:
    """Return the line on two conditions with other values at some nodes, one at a place."""
    where = ", ".join(f"{x:.4g}" for x in place)
    return (
        f"{pair} prescribe other values of {', '.join(AXES[i] for i in axes)} at {count} common "
        f"nodes, one at ({where}), where {taken} is taken: the displacement jumps within a cell "
        "beside them, so forces there grow with finer meshes"
    )


def _displacement(condition: Any, X: Array, load: float) -> Array:
    """Return the (n, 3) displacements of a condition at a load; of a `Constraint` they are zero."""
    if hasattr(condition, "displacement"):
        found: Array = condition.displacement(X, load)
        return found
    return np.zeros_like(X)


def axis_nodes(V: Any) -> Array:
    """Return the local nodes of V, ghosts included, on the axis of revolution x = 0. Collective."""
    x = V.tabulate_dof_coordinates()
    size = V.mesh.comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX)
    return np.flatnonzero(x[:, 0] <= ON_AXIS * size)


def facets_plane(V: Any, facets: Array, key: str, name: Any) -> NodePlane:
    """Return the plane in which this rank's facets (n,), with those of other ranks, lie.

    Collective. It raises BadInput on every rank, with the key and the name, if they lie in none.
    """
    dim = _dolfinx.mesh_dimension(V.mesh)[0]
    nodes = _dolfinx.locate_dofs(V, dim - 1, facets)
    owned = nodes[nodes < _dolfinx.num_nodes(V)[0]]
    normal = plane_through(V.mesh.comm, V.tabulate_dof_coordinates()[owned, :dim])
    if normal is None:
        shape = "plane surface" if dim == 3 else "straight curve"
        raise bad_value(key, name, f"a {shape}; several are several conditions of symmetry")
    return NodePlane(nodes, np.pad(normal, (0, _dolfinx.num_components(V) - dim)))


def _plane_of_group(V: Any, mesh: Mesh, key: str | int) -> NodePlane:
    """Return the plane in which a physical group lies. Collective."""
    group = mesh.group(key)
    if group.dim != mesh.dim - 1:
        accepted = f"a {DIMENSIONS[mesh.dim - 1]}, not a {group.label}"
        raise bad_value("symmetry.group", key, accepted)
    return facets_plane(V, group.entities, "symmetry.group", key)


def group_nodes(V: Any, mesh: Mesh, key: str | int) -> Array:
    """Return the local nodes of V, ghosts included, on a physical group. Collective."""
    group = mesh.group(key)
    return _dolfinx.locate_dofs(V, group.dim, group.entities)


class CountedForces(NamedTuple):
    """The parts of nodal forces that count for the reaction of a group.

    Attributes
    ----------
    weights : (nodes, components, components) array
        Symmetric matrices, by which forces on the nodes that this rank owns are multiplied.
    shared : int
        At how many of this rank's nodes others have set all that the group's conditions constrain.
    others : set of str
        Their groups, by name or number.
    """

    weights: Array
    shared: int = 0
    others: frozenset[str] = frozenset()


def group_forces(V: Any, mesh: Mesh, key: str | int, dirichlet: Dirichlet) -> CountedForces:
    """Return the parts of nodal forces that count for the reaction of a group. Collective.

    They are those of its conditions: see `counted_forces`. Of a group without conditions, as one
    that others cover, all count.
    """
    owned, components = _dolfinx.num_nodes(V)[0], _dolfinx.num_components(V)
    label = mesh.group(key).label
    if label in [condition.label for condition in dirichlet.conditions]:
        return counted_forces(dirichlet, label, owned, components)
    weights, nodes = np.zeros((owned, components, components)), group_nodes(V, mesh, key)
    weights[nodes[nodes < owned]] = np.eye(components)
    return CountedForces(weights)


def counted_forces(dirichlet: Dirichlet, label: str, owned: int, components: int) -> CountedForces:
    """Return the parts of the forces at the owned nodes that count for conditions of one label.

    They are those along what these conditions constrain: on the edge of two surfaces each has the
    force of its own condition. What several conditions constrain counts for the one that sets the
    value, the last: the reactions of all conditions balance the loads.
    """
    # The directions of each node that later conditions have, as projections.
    weights, taken = np.zeros((2, owned, components, components))
    in_rigid = divmod(dirichlet.released, components)
    taken[in_rigid] = np.eye(components)[in_rigid[1]]
    own = [n for c in dirichlet.conditions if c.label == label for _, n in c.directions]
    shared, takers = np.zeros(owned, dtype=bool), list[tuple[str, Array]]()
    for condition in reversed(dirichlet.conditions):
        for nodes, normal in condition.directions:
            nodes = nodes[nodes < owned]
            part, size = take_direction(taken, nodes, normal)
            if condition.label == label:
                weights[nodes] += part
                shared[nodes[size < 1 - _DEPENDENT]] = True
            elif (np.abs(np.array(own) @ normal) > _DEPENDENT).any():
                takers.append((condition.label, nodes))
    if len(in_rigid[0]):
        takers.append(("rigid parts", in_rigid[0]))
    shared &= ~weights.any(axis=(1, 2))
    others = {name.partition(":")[2] or name for name, nodes in takers if shared[nodes].any()}
    return CountedForces(weights, int(shared.sum()), frozenset(others))


def take_direction(taken: Array, nodes: Array, normal: Array) -> tuple[Array, Array]:
    """Take what is left of a direction at some nodes.

    Parameters
    ----------
    taken : (all nodes, components, components) array
        The projections on the directions that are taken, to which the new ones are added.
    nodes : (n,) int
        The nodes.
    normal : (components,) array
        The direction, of size 1.

    Returns
    -------
    parts : (n, components, components) array
        The projections on what was left.
    size : (n,) array
        How much of the direction was left, from 0 to 1.
    """
    free: Array = normal - taken[nodes] @ normal
    size = np.linalg.norm(free, axis=1)
    direction = free / np.where(size > _DEPENDENT, size, np.inf)[:, None]
    parts = direction[:, :, None] * direction[:, None]
    taken[nodes] += parts
    return parts, size
