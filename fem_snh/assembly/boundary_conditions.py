"""Dirichlet conditions: which displacement components are constrained, and their values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.inclined_planes import InclinedPlanes, NodePlane, plane_through
from fem_snh.assembly.kinematics import SOLID, Kinematics
from fem_snh.assembly.unknowns import summed_over_ranks
from fem_snh.errors import bad_value, in_words
from fem_snh.mesh.mesh_checks import ON_AXIS

if TYPE_CHECKING:
    from fem_snh.mesh.mesh import Mesh

AXES = ("x", "y", "z")
#: The label of the conditions that bones prescribe.
BONES = "bones"
#: Loads at which the values of two conditions are compared, and the difference, relative to the
#: largest value, up to which the values are equal but for rounding.
_LOADS, _ROUNDING = (0.25, 0.5, 1.0), 1e-9
#: Sine of the angle below which two constrained directions are the same, as for inclined planes.
_DEPENDENT = 1e-7


@dataclass(eq=False)
class Condition:
    """The dofs that one condition constrains, and their values.

    Attributes
    ----------
    key : str
        The key of the condition's group in messages, e.g. "hold.group"; in a program "bcs[0]" or
        "bcs[0].group".
    name : str
        The name of the condition in messages, e.g. "[[hold]] of 'left'"; in a program "bcs[0]".
    label : str
        The label of the physical group; "bones" for all bones; otherwise ``bcs[number]``.
    given : object
        The table, dolfinx DirichletBC or bone (with its nodes) from which the condition is made.
    directions : sequence of ((n,) int, (components,) array)
        Local nodes, ghosts included, and the unit vector of the direction constrained there.
    dofs : (n,) int
        The owned dofs whose values the condition sets; empty for a plane of symmetry.
    set_values : callable, optional
        ``set_values(values, load)`` sets the condition's values [m] in an array of owned dofs.
        None: the values are zero.
    moves : bool
        Whether the values depend on the load.
    by_hand : bool
        Whether a program may change the values from step to step.
    plane : NodePlane or None
        For a condition of symmetry, the plane in which the nodes slide.
    """

    key: str
    name: str
    label: str
    given: Any
    directions: Sequence[tuple[Array, Array]]
    dofs: Array = field(default_factory=lambda: np.empty(0, np.int64))
    set_values: Callable[[Array, float], None] | None = None
    moves: bool = False
    by_hand: bool = False
    plane: NodePlane | None = None

    @classmethod
    def of_mask(cls, name: str, given: Any, owned: int, mask: Array, **values: Any) -> Condition:
        """Return a condition on the components in ``mask``, (local nodes, components) bool.

        ``name`` is also its key and label, ``owned`` the number of nodes that this rank owns, and
        ``values`` are further attributes.
        """
        units = np.eye(mask.shape[1])
        directions = [(np.flatnonzero(m), n) for m, n in zip(mask.T, units, strict=True)]
        return cls(name, name, name, given, directions, np.flatnonzero(mask[:owned]), **values)

    def mark(self, mask: Array) -> None:
        """Set ``mask`` (local nodes, components) to True at the constrained components.

        A plane of symmetry marks none.
        """
        for nodes, normal in () if self.plane else self.directions:
            mask[nodes, normal.argmax()] = True

    @property
    def components(self) -> set[int]:
        """The numbers of the constrained components; empty for a plane of symmetry."""
        return set() if self.plane else {int(normal.argmax()) for _, normal in self.directions}


class ThinSupports(NamedTuple):
    """Conditions at points or, in three dimensions, edges: supports without an area.

    Attributes
    ----------
    text : str
        The names of the conditions, e.g. "[[hold]] of 'corner'".
    dofs : (n,) int
        The owned constrained dofs that are on no facet constrained as a whole.
    """

    text: str
    dofs: Array


class Dirichlet:
    """The constrained directions of a displacement space and their values. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    conditions : sequence of Condition
        The conditions. At common nodes a later condition overrides an earlier one, and any other
        condition overrides planes of symmetry.
    kinematics : Kinematics, optional
        On a body of revolution the radial and rotational displacements are zero on the axis,
        whatever else is prescribed there.
    on_load : callable, optional
        ``on_load(load)`` sets a program's constants, functions and boundary values.

    Attributes
    ----------
    constrained : (local nodes, components) bool
        Which components of which nodes, ghosts included, are constrained.
    dofs : (n,) int
        The constrained dofs this rank owns, as indices into a vector's local array.
    planes : InclinedPlanes or None
        The nodes with a constrained direction that is no coordinate axis.
    depends_on_load : bool
        Whether any value depends on the load.
    by_hand : bool
        Whether there is no ``on_load`` and a program may change values from step to step.
    released : (n,) int
        Owned dofs of rigid parts that were constrained before `release`: values that `set_values`
        sets there have no effect, as the part's unknowns determine the displacement.
    rigid_parts : (local nodes,) int or None
        The rigid part of each node, -1 for no part. None if the body has no rigid parts.
    part_motions : sequence of (n, 2, 3)
        For each rigid part, the n rigid motions at the reference configuration that joints admit or
        motions prescribe: the velocity of the part's point at the origin, and the angular velocity.
        `fem_snh.terms.rigid_parts.RigidParts` sets them.
    conditions : list of Condition
        The conditions, planes of symmetry first.
    offset : (n,) array or None
        The difference [m] at ``dofs`` between an initial state and the conditions at load 0. The
        values are those of the conditions plus (1 - load) times the offset. None without an initial
        state.

    Raises
    ------
    BadInput
        On every rank, for a motion that takes nodes out of a plane of symmetry.
    """

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        conditions: Sequence[Condition] = (),
        kinematics: Kinematics = SOLID,
        on_load: Callable[[float], None] | None = None,
    ) -> None:
        owned, ghosts = _dolfinx.num_nodes(V)
        components = kinematics.components
        self._V, self._owned, self._on_load = V, owned, on_load
        self.constrained: Array = np.zeros((owned + ghosts, components), dtype=bool)
        for condition in conditions:
            condition.mark(self.constrained)
        self._axis = axis_nodes(V) if kinematics.revolved else np.empty(0, np.int64)
        self.constrained[self._axis[:, None], kinematics.off_axis] = True
        on_axis = self._axis[self._axis < owned]
        offsets = np.array(kinematics.off_axis, np.int64)
        self._on_axis = (components * on_axis[:, None] + offsets).ravel()
        self.conditions = sorted(conditions, key=lambda condition: condition.plane is None)
        planes = [condition.plane for condition in self.conditions if condition.plane]
        self.planes = InclinedPlanes.of(planes, self.constrained, owned)
        self.dofs = np.flatnonzero(self.constrained[:owned])
        self._moves = any(condition.moves for condition in conditions)
        self.by_hand = on_load is None and any(condition.by_hand for condition in conditions)
        self.offset: Array | None = None
        self.released: Array = np.empty(0, np.int64)
        self.rigid_parts: Array | None = None
        self.part_motions: Sequence[Array] = ()
        if self._moves:
            self._check_planes()

    @property
    def depends_on_load(self) -> bool:
        """Whether any value depends on the load."""
        return self._moves or self.offset is not None or self._on_load is not None

    @property
    def bones(self) -> list[Any]:
        """The bones with their nodes. Their conditions override all other conditions."""
        return [condition.given for condition in self.conditions if condition.label == BONES]

    def of_label(self, label: str) -> list[Condition]:
        """Return the conditions of a physical group, by its label."""
        return [condition for condition in self.conditions if condition.label == label]

    def release(self, parts: Array) -> None:
        """Remove the constraints of the nodes of rigid parts.

        Sets ``rigid_parts`` and ``released``, and changes ``constrained`` and ``dofs``.

        Parameters
        ----------
        parts : (local nodes,) int
            The rigid part of each node, -1 for no part.
        """
        before, self.rigid_parts = self.dofs, parts
        self.constrained[parts >= 0] = False
        self.dofs = np.flatnonzero(self.constrained[: self._owned])
        self.released = np.setdiff1d(before, self.dofs)

    def set_load(self, load: float) -> None:
        """Call ``on_load``, if given: set a program's constants and functions for this load."""
        if self._on_load is not None:
            self._on_load(load)

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set the constrained displacements in ``x`` to their values at this load.

        Calls `set_load`. Only owned entries are set; ghosts are not updated.
        """
        self.set_load(load)
        # Pressures may follow the displacement: ghosts of the conditions must not reach them.
        values = x.array[: self.constrained.shape[1] * self._owned]
        values[self.dofs] = 0.0
        for condition in self.conditions:
            _set(condition, values, load)
        values[self._on_axis] = 0.0
        if self.offset is not None:
            values[self.dofs] += (1 - load) * self.offset
        if self.planes:
            self.planes.prescribe(values)

    def start_from(self, x: PETSc.Vec) -> None:
        """Let values vary linearly with the load from ``x`` (load 0) to the conditions (load 1).

        Sets ``offset``.
        """
        own, self.offset = x.copy(), None
        self.set_values(own, 0.0)
        self.offset = x.array_r[self.dofs] - own.array_r[self.dofs]

    def project(self, values: Array, ghosts: bool = False) -> None:
        """Set displacements or forces to zero along constrained directions, in place.

        Parameters
        ----------
        values : (n,) array
            Begins with the components of the owned nodes; further entries do not change.
        ghosts : bool
            Whether ``values`` begins with the components of all local nodes instead.
        """
        values[self.constrained.ravel() if ghosts else self.dofs] = 0.0
        if self.planes:
            self.planes.project(values, ghosts)

    def work(self, forces: Array, moved: Array) -> float:
        """Return the work [J] along constrained directions at this rank's own nodes.

        Parameters
        ----------
        forces, moved : (n,) array
            Forces [N] and displacements [m], beginning with the components of the owned nodes.
        """
        found = float(forces[self.dofs] @ moved[self.dofs])
        return found + (self.planes.work(forces, moved) if self.planes else 0.0)

    @property
    def constrained_nodes(self) -> Array:
        """Which nodes, ghosts included, have a constrained direction, (local nodes,) bool."""
        found: Array = np.any(self.constrained, axis=1)
        if self.planes:
            found[self.planes.nodes] = True
        return found

    @cached_property
    def thin_supports(self) -> ThinSupports | None:
        """The conditions at nodes on no constrained facet; None without any. Collective.

        Nodes in bones, in planes of symmetry and on the axis of revolution do not count.
        """
        marked = self.constrained & ~covered_nodes(self._V, self.constrained, self._axis)
        for condition in self.conditions:
            if condition.plane:
                nodes, normal = condition.plane
                marked[np.ix_(nodes, abs(normal) > _ROUNDING)] = False
            elif condition.label == BONES:
                marked[condition.given.nodes] = False
        thin = np.setdiff1d(np.flatnonzero(marked[: self._owned]), self._on_axis)
        used = np.array([np.isin(thin, condition.dofs).any() for condition in self.conditions])
        found = self._V.mesh.comm.allreduce(used.astype(np.int32))
        names = [c.name for c, is_used in zip(self.conditions, found, strict=True) if is_used]
        return ThinSupports(", ".join(names), thin) if names else None

    def contradictions(self) -> list[str]:
        """Return a line for each pair of conditions that differ at common nodes. Collective.

        A dolfinx DirichletBC that others override at all of its dofs does not count. Without
        motions and DirichletBCs the result is empty.

        Raises
        ------
        BadInput
            On every rank, if a later table overrides the components of an earlier table by other
            values at all of the earlier table's nodes.
        """
        if not (self._moves or any(condition.by_hand for condition in self.conditions)):
            return []
        comm, components = self._V.mesh.comm, self.constrained.shape[1]
        values = np.zeros((len(_LOADS), components * self._owned))
        taken, given = np.full(values.shape[1], -1), list[Array]()
        for number, condition in enumerate(self.conditions):
            for row, load in zip(values, _LOADS, strict=True):
                _set(condition, row, load)
            taken[condition.dofs] = number
            given.append(values[:, condition.dofs])
        rounding = _ROUNDING * comm.allreduce(abs(values).max(initial=0.0), op=MPI.MAX)
        X, lines = self._V.tabulate_dof_coordinates(), []
        X = np.where(abs(X) > _ROUNDING * abs(X).max(initial=0.0), X, 0.0)
        for number, condition in enumerate(self.conditions):
            dofs, takers = condition.dofs, taken[condition.dofs]
            differs = (abs(given[number] - values[:, dofs]) > rounding).any(axis=0)
            for later, by in enumerate(self.conditions[number + 1 :], number + 1):
                if by.label == BONES:
                    continue
                nodes, axes = np.divmod(dofs[(takers == later) & differs], components)
                shared = np.isin(dofs % components, list(by.components))
                own = (
                    np.unique(nodes),
                    X[nodes[:1]],
                    {*axes.tolist()},
                    (takers == number).any(),
                    (shared & (takers != later)).any(),
                )
                of_ranks = comm.allgather(own)
                counts, places, found, is_kept, is_shared = zip(*of_ranks, strict=True)
                if not (count := sum(map(len, counts))):
                    continue
                pair, by_hand = in_words([condition.name, by.name]), condition.by_hand
                if not (any(is_shared) or by_hand or by.by_hand):
                    words = _axes_in_words(by.components & condition.components)
                    accepted = f"components other than {words}, which {condition.name} constrains"
                    raise bad_value(by.key, by.given.group, f"{accepted} at the same nodes")
                if any(is_kept) or not by_hand:
                    words = _axes_in_words(set[int]().union(*found))
                    place = ", ".join(f"{x:.4g}" for x in np.concatenate(places)[0])
                    lines.append(
                        f"{pair} prescribe other values of {words} at {count} common nodes, one at "
                        f"({place}), where {by.name} is taken: the displacement jumps within a "
                        "cell beside them, so forces there grow with finer meshes"
                    )
        return lines

    def _check_planes(self) -> None:
        """Raise BadInput if motions displace nodes out of a plane of symmetry. Collective."""
        u, components = _dolfinx.create_vector(self._V), self.constrained.shape[1]
        planes = [condition for condition in self.conditions if condition.plane]
        for load in _LOADS if planes else ():
            self.set_values(u, load)
            values = u.array_r.reshape(-1, components)
            for condition in planes:
                nodes, normal = condition.directions[0]
                moved = values[nodes[nodes < self._owned]] @ normal
                sizes = np.array([abs(moved).max(initial=0.0), abs(values).max(initial=0.0)])
                self._V.mesh.comm.Allreduce(MPI.IN_PLACE, sizes, op=MPI.MAX)
                if sizes[0] > _ROUNDING * sizes[1]:
                    accepted = "a plane that no [[move]] and no [[bone]] takes nodes out of"
                    raise bad_value("symmetry.group", condition.given.group, accepted)


def _set(condition: Condition, values: Array, load: float) -> None:
    """Set the values of a condition in an array of owned dofs."""
    if condition.set_values is None:
        values[condition.dofs] = 0.0
    else:
        condition.set_values(values, load)


def _axes_in_words(axes: set[int]) -> str:
    """Return the names of axes, sorted, as text, e.g. "x, z"."""
    return ", ".join(AXES[axis] for axis in sorted(axes))


def axis_nodes(V: _dolfinx.FunctionSpace) -> Array:
    """Return the local nodes of V, ghosts included, on the axis of revolution x = 0. Collective."""
    x = V.tabulate_dof_coordinates()
    size = V.mesh.comm.allreduce(float(np.abs(x).max(initial=0.0)), op=MPI.MAX)
    return np.flatnonzero(x[:, 0] <= ON_AXIS * size)


def facets_plane(V: _dolfinx.FunctionSpace, facets: Array, key: str, name: Any) -> NodePlane:
    """Return the plane that contains the facets of all ranks, with its local nodes. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    facets : (n,) int
        This rank's facets.
    key, name : str, object
        The group's key and value, for the message.

    Raises
    ------
    BadInput
        On every rank, if the facets are not in one plane (in two dimensions: on one line).
    """
    dim = _dolfinx.mesh_dimension(V.mesh)[0]
    nodes = _dolfinx.locate_dofs(V, dim - 1, facets)
    owned = nodes[nodes < _dolfinx.num_nodes(V)[0]]
    normal = plane_through(V.mesh.comm, V.tabulate_dof_coordinates()[owned, :dim])
    if normal is None:
        shape = "plane surface" if dim == 3 else "straight curve"
        raise bad_value(key, name, f"a {shape}; several are several conditions of symmetry")
    return NodePlane(nodes, np.pad(normal, (0, _dolfinx.num_components(V) - dim)))


def covered_nodes(V: _dolfinx.FunctionSpace, constrained: Array, axis: Array) -> Array:
    """Return, for each component, the nodes of facets constrained at all nodes. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    constrained : (local nodes, components) bool
        The constrained components, ghosts included.
    axis : (n,) int
        Local nodes on the axis of revolution. Facets on the axis have no area and do not count.

    Returns
    -------
    (local nodes, components) bool
    """
    cells = _dolfinx.node_dofs(V)
    off_axis = np.ones(len(constrained), dtype=bool)
    off_axis[axis] = False
    marks = np.zeros(constrained.shape)
    for local in _dolfinx.facet_nodes(V):
        nodes = cells[:, local]
        whole = constrained[nodes].all(axis=1) & off_axis[nodes].any(axis=1)[:, None]
        for component in range(constrained.shape[1]):
            marks[nodes[whole[:, component]], component] = 1.0
    return summed_over_ranks(V, marks) > 0


def group_nodes(V: _dolfinx.FunctionSpace, mesh: Mesh, key: str | int) -> Array:
    """Return the local nodes of V, ghosts included, on a physical group. Collective."""
    group = mesh.group(key)
    return _dolfinx.locate_dofs(V, group.dim, group.entities)


class CountedForces(NamedTuple):
    """The parts of nodal forces that count for the reaction of a group.

    Attributes
    ----------
    weights : (owned nodes, components, components) array
        For each node a projection: the part that counts of the force f is ``weights @ f``.
    shared : int
        Number of owned nodes that the group's conditions constrain, but only in directions that
        later conditions set.
    others : set of str
        The groups of these later conditions, by name or number; "rigid parts" for rigid parts.
    """

    weights: Array
    shared: int = 0
    others: frozenset[str] = frozenset()


def group_forces(
    V: _dolfinx.FunctionSpace, mesh: Mesh, key: str | int, dirichlet: Dirichlet
) -> CountedForces:
    """Return the parts of nodal forces that count for the reaction of a group. Collective.

    The forces of the group's conditions count: see `counted_forces`. If the group itself has no
    conditions, all forces at its nodes count.
    """
    owned, components = _dolfinx.num_nodes(V)[0], _dolfinx.num_components(V)
    label = mesh.group(key).label
    if own := dirichlet.of_label(label):
        return counted_forces(dirichlet, own, owned, components)
    weights, nodes = np.zeros((owned, components, components)), group_nodes(V, mesh, key)
    weights[nodes[nodes < owned]] = np.eye(components)
    return CountedForces(weights)


def counted_forces(
    dirichlet: Dirichlet, some: Sequence[Condition], owned: int, components: int
) -> CountedForces:
    """Return the parts of the owned nodes' forces that count for ``some`` of the conditions.

    Forces along the directions that these conditions constrain count. A direction that several
    conditions constrain counts for the last of them, which sets the value; the reactions of all
    conditions then balance the loads.
    """
    # For each node, the projection on the directions that later conditions constrain.
    weights, taken = np.zeros((2, owned, components, components))
    in_rigid = divmod(dirichlet.released, components)
    taken[in_rigid] = np.eye(components)[in_rigid[1]]
    own = [normal for condition in some for _, normal in condition.directions]
    shared, takers = np.zeros(owned, dtype=bool), list[tuple[str, Array]]()
    for condition in reversed(dirichlet.conditions):
        for nodes, normal in condition.directions:
            nodes = nodes[nodes < owned]
            part, size = take_direction(taken, nodes, normal)
            if condition in some:
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
    """Orthogonalise a direction against the directions taken at some nodes, and take it.

    Parameters
    ----------
    taken : (all nodes, components, components) array
        For each node the projection on the taken directions. The new direction is added in place.
    nodes : (n,) int
        The nodes.
    normal : (components,) array
        The unit vector of the direction.

    Returns
    -------
    parts : (n, components, components) array
        The projections on the new orthogonal directions; zero where ``size`` is zero.
    size : (n,) array
        The norm of the part of ``normal`` that is orthogonal to the taken directions, from 0 to 1.
    """
    free: Array = normal - taken[nodes] @ normal
    size = np.linalg.norm(free, axis=1)
    direction = free / np.where(size > _DEPENDENT, size, np.inf)[:, None]
    parts = direction[:, :, None] * direction[:, None]
    taken[nodes] += parts
    return parts, size
