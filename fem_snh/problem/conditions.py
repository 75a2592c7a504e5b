"""Dirichlet conditions of a displacement space: from tables, bones and dolfinx conditions."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import BONES, Condition, Dirichlet, facets_plane
from fem_snh.assembly.kinematics import Kinematics
from fem_snh.assembly.regions import boundary_facets, find_group
from fem_snh.assembly.unknowns import (
    copy_to_function,
    local_values,
    summed_over_ranks,
    update_ghosts,
)
from fem_snh.errors import bad_value
from fem_snh.mesh.mesh import Mesh
from fem_snh.tables.amplitudes import LOAD_ITSELF, Amplitudes
from fem_snh.tables.types import surface_name
from fem_snh.terms.dirichlet import Move, Symmetry

if TYPE_CHECKING:
    from fem_snh.problem.bones import BoneNodes

#: Distance on the reference cell below which two nodes are the same.
_SAME = 1e-9
#: The accepted objects in ``bcs``, for messages.
ACCEPTED = "a condition made by dolfinx.fem.dirichletbc, or Symmetry, Hold or Move"


class LoadFunction:
    """A callable that passes the load to ``function``, or does nothing if that is None.

    The conditions hold it in place of a bound method of the program's problem: PETSc's SNES refers
    to the conditions, and Python's collector does not find a cycle that leads through PETSc.
    """

    def __init__(self) -> None:
        self.function: Callable[[float], None] | None = None

    def __call__(self, load: float) -> None:
        if self.function is not None:
            self.function(load)


def place_conditions(
    V: _dolfinx.FunctionSpace,
    mesh: Mesh,
    given: Sequence[Any],
    kinematics: Kinematics,
    bones: Sequence[BoneNodes] = (),
    on_load: Callable[[float], None] | None = None,
    lifted: LiftedValues | None = None,
    amplitudes: Amplitudes = LOAD_ITSELF,
) -> Dirichlet:
    """Return the Dirichlet conditions of a displacement space. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    mesh : Mesh
        The mesh whose physical groups tables may name.
    given : sequence of Hold, Move, Symmetry or dolfinx DirichletBC
        The conditions: see `Dirichlet`.
    kinematics : Kinematics
        The kinematics. A component that it lacks is left out of a Hold or Move.
    bones : sequence of BoneNodes, optional
        Bones with disjoint sets of nodes; they override all other conditions.
    on_load : callable, optional
        As for `Dirichlet`.
    lifted : LiftedValues, optional
        Transfers dolfinx conditions to V, if they are on another space.
    amplitudes : Amplitudes, optional
        The tables that motions may name.

    Raises
    ------
    BadInput
        On every rank, for an object that is no condition on this space, an unknown physical group,
        a condition that a later motion overrides at all of its nodes, a curved surface of symmetry,
        and a motion that takes nodes out of a plane of symmetry.
    """
    place = _Place(V, mesh, kinematics, lifted, amplitudes)
    conditions = [place.condition(one, number) for number, one in enumerate(given)]
    conditions += [
        place.moving(bone, BONES, bone.nodes, range(3), bone, bone.moves) for bone in bones
    ]
    dirichlet = Dirichlet(V, conditions, kinematics, on_load)
    if lifted is None and any(condition.moves for condition in conditions):
        dirichlet.contradictions()  # raises BadInput for what a motion overrides as a whole
    return dirichlet


class _Place:
    """Creates each `Condition` of a displacement space: see `place_conditions`."""

    def __init__(
        self,
        V: _dolfinx.FunctionSpace,
        mesh: Mesh,
        kinematics: Kinematics,
        lifted: LiftedValues | None,
        amplitudes: Amplitudes,
    ) -> None:
        self._amplitudes, self._lifted = amplitudes, lifted
        self._V, self._mesh, self._kinematics = V, mesh, kinematics
        self._owned, self._X = _dolfinx.num_nodes(V)[0], V.tabulate_dof_coordinates()

    def condition(self, given: Any, number: int) -> Condition:
        """Return the `Condition` of ``bcs[number]``, the object ``given``. Collective."""
        label = f"bcs[{number}]"
        if not is_condition(given):
            raise bad_value(label, given, ACCEPTED)
        if hasattr(given, "dof_indices"):
            return self._of_dolfinx(given, label)
        motion = given.scaled(self._amplitudes) if isinstance(given, Move) else given
        moves = hasattr(motion, "displacement")
        table = "symmetry" if isinstance(given, Symmetry) else "move" if moves else "hold"
        named = isinstance(given.group, str | int) and bool(self._mesh.groups)
        key = f"{table}.group" if named else f"{label}.group"
        if isinstance(given, Symmetry):
            facets = boundary_facets(self._mesh, key, given.group)
            plane = facets_plane(self._V, facets, key, surface_name(given.group))
            found = Condition(key, label, label, given, [(plane.nodes, plane.normal)], plane=plane)
        else:
            group = find_group(self._mesh, key, given.group)
            nodes = _dolfinx.locate_dofs(self._V, group.dim, group.entities)
            found = self.moving(given, label, nodes, self._axes(given), motion, moves)
        if named:
            found.name = f"[[{table}]] of {given.group!r}"
            found.label = self._mesh.group(given.group).label
        found.key = key
        return found

    def moving(
        self,
        given: Any,
        label: str,
        nodes: Array,
        axes: Sequence[int],
        motion: Any,
        moves: bool,
    ) -> Condition:
        """Return the condition on the components ``axes`` of local nodes, (n,) int.

        The values are ``motion.displacement(X, load)`` [m], or zero without such a method.
        """
        components, units = self._kinematics.components, np.eye(self._kinematics.components)
        directions = [(nodes, units[axis]) for axis in axes]
        own = nodes[nodes < self._owned]
        dofs = components * own[:, None] + list(axes)
        found = Condition(label, label, label, given, directions, dofs.ravel(), moves=moves)
        if hasattr(motion, "displacement"):
            X = self._X[own]

            def set_values(values: Array, load: float) -> None:
                values[dofs] = motion.displacement(X, load)[:, list(axes)]

            found.set_values = set_values
        return found

    def _axes(self, given: Any) -> list[int]:
        """Return the numbers of a condition's components that the kinematics has.

        It raises BadInput if there is none.
        """
        known = self._kinematics.axes
        axes = [known.index(c) for c in given.components if c in known]
        if not axes:
            accepted = f"some of {', '.join(known)}, the components in {self._kinematics.name}"
            raise bad_value("components", list(given.components), accepted)
        return axes

    def _of_dolfinx(self, bc: Any, label: str) -> Condition:
        """Return the `Condition` of a dolfinx DirichletBC, on V or transferred to V. Collective."""
        if self._lifted:
            return self._lifted.condition(bc, label, self._owned)
        if not _dolfinx.bc_space_is_within(bc, self._V):
            accepted = "a condition on the displacement's function space or a component of it"
            raise bad_value(label, "a condition on another space", accepted)
        dofs, components = _dolfinx.bc_dofs(bc), self._kinematics.components
        # A condition may lack ghosts of its constrained nodes.
        mask = _dolfinx.create_vector(self._V)
        mask.array[dofs[dofs < components * self._owned]] = 1.0
        if mask.norm() == 0:
            accepted = "a condition on at least one node of the mesh"
            raise bad_value(label, "a condition on no dof", accepted)
        update_ghosts(mask)
        constrained = local_values(mask).reshape(-1, components) > 0

        def set_values(values: Array, load: float) -> None:
            _dolfinx.set_bcs(values, [bc])

        values: dict[str, Any] = {"set_values": set_values, "by_hand": True}
        return Condition.of_mask(label, bc, self._owned, constrained, **values)


class LiftedValues:
    """Transfers dolfinx conditions to another space on the same cells. Collective.

    A node of W is constrained if it coincides with a constrained node of V, or if it is in a cell,
    on a facet of the boundary or on a facet inside of the body all of whose nodes in V are
    constrained. The values are interpolated.

    Parameters
    ----------
    dirichlet : Dirichlet
        The conditions on V.
    V : dolfinx function space
        The program's space.
    W : dolfinx function space
        The other space.
    state : dolfinx Function, optional
        A displacement in W: the boundary values at all loads. Default: the values of the conditions
        at each load.
    """

    def __init__(
        self,
        dirichlet: Dirichlet,
        V: _dolfinx.FunctionSpace,
        W: _dolfinx.FunctionSpace,
        state: Any = None,
    ) -> None:
        self._dirichlet, self._V, self._W = dirichlet, V, W
        self._vector, self._given = _dolfinx.create_vector(V), _dolfinx.function(V, "given")
        self._lifted = _dolfinx.function(W, "lifted")
        #: The load at which the values were interpolated; None if a state gives them.
        self._load: float | None = np.nan
        if state is not None:
            self._lifted.x.array[:], self._load = state.x.array, None

    def condition(self, bc: Any, label: str, owned: int) -> Condition:
        """Return the `Condition` on W (``owned`` nodes) of a DirichletBC on V. Collective."""
        mask = np.zeros_like(self._dirichlet.constrained)
        condition_of(self._dirichlet, bc, label).mark(mask)
        mask = _lifted_mask(self._V, self._W, mask)
        found = Condition.of_mask(label, bc, owned, mask)

        def set_values(values: Array, load: float) -> None:
            values[found.dofs] = self._at(load)[found.dofs]

        found.set_values = set_values
        return found

    def _at(self, load: float) -> Array:
        """Return the values [m] at a load, (local dofs of W,), not a copy. Collective."""
        if self._load is not None and load != self._load:
            self._dirichlet.set_values(self._vector, load)
            update_ghosts(self._vector)
            copy_to_function(self._vector, self._given)
            self._lifted.interpolate(self._given)
            self._load = load
        values: Array = self._lifted.x.array
        return values


def _lifted_mask(V: _dolfinx.FunctionSpace, W: _dolfinx.FunctionSpace, mask: Array) -> Array:
    """Transfer ``mask``, the constrained components of V's nodes, to W's nodes. Collective.

    Both masks are (local nodes, components) bool; `LiftedValues` has the rule.
    """
    cell = _dolfinx.cell_name(V.mesh)
    points = [_dolfinx.reference_nodes(cell, _dolfinx.degree(space)) for space in (V, W)]
    distance = np.linalg.norm(points[1][:, None] - points[0][None], axis=2)
    same = np.where(distance.min(axis=1) < _SAME, distance.argmin(axis=1), -1)
    old, new = _dolfinx.node_dofs(V), _dolfinx.node_dofs(W)
    facets = list(zip(_dolfinx.facet_nodes(V), _dolfinx.facet_nodes(W), strict=True))
    inside = mask[old]  # (cells, nodes, components)
    whole = inside.all(axis=1)
    of_facets = np.stack([inside[:, base].all(axis=1) for base, _ in facets])
    _, cells, local = _dolfinx.exterior_facets(V.mesh)
    on_boundary = np.zeros(of_facets.shape[:2], bool)
    on_boundary[local, cells] = True
    outer = of_facets & on_boundary[..., None]
    # Constrained nodes in no such cell or boundary facet are on a surface inside of the body.
    marks = np.zeros(mask.shape)
    np.maximum.at(marks, old, whole[:, None])
    for (base, _), constrained in zip(facets, outer, strict=True):
        np.maximum.at(marks, old[:, base], constrained[:, None])
    explained = (summed_over_ranks(V, marks) > 0)[old]
    marks = np.zeros((sum(_dolfinx.num_nodes(W)), mask.shape[1]))
    np.maximum.at(marks, new[:, same >= 0], inside[:, same[same >= 0]])
    np.maximum.at(marks, new, whole[:, None])
    for (base, lifted), constrained, on in zip(facets, of_facets, outer, strict=True):
        inner = constrained & ~explained[:, base].all(axis=1)
        np.maximum.at(marks, new[:, lifted], (on | inner)[:, None])
    return summed_over_ranks(W, marks) > 0


def condition_of(dirichlet: Dirichlet, given: Any, key: str) -> Condition:
    """Return the condition made of an object of ``bcs``; raise BadInput for any other object."""
    for condition in dirichlet.conditions:
        if condition.given is given:
            return condition
    shown = "a condition" if is_condition(given) else given
    raise bad_value(key, shown, "one of the problem's bcs")


def is_condition(given: Any) -> bool:
    """Return whether an object is a dolfinx DirichletBC, Symmetry, Hold or Move."""
    is_table = isinstance(given, Symmetry) or hasattr(given, "components")
    return hasattr(given, "dof_indices") or (is_table and hasattr(given, "group"))
