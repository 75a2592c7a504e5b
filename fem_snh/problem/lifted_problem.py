"""The problem of a dolfinx program in another element on the same mesh, at its present state.

A scene makes its problem again from its tables. A program has objects of dolfinx on its own space:
constrained dofs and forms, which are carried over to the new space here.
"""

from __future__ import annotations

from functools import partial
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import Dirichlet, axis_nodes, facets_plane
from fem_snh.assembly.elements import Element
from fem_snh.assembly.inclined_planes import InclinedPlanes
from fem_snh.assembly.kinematics import Kinematics
from fem_snh.assembly.unknowns import (
    copy_to_function,
    create_unknowns,
    summed_over_ranks,
    update_ghosts,
)
from fem_snh.errors import BadInput
from fem_snh.problem.dolfinx_problem import (
    DEFAULT_RULES,
    RULE_KEYS,
    DolfinxConditions,
    condition_of_mask,
    conditions_of_planes,
    set_modulus,
)
from fem_snh.problem.problem import Problem
from fem_snh.tables.amplitudes import Amplitudes
from fem_snh.terms.body import Body, CreateMotion, measure_facets, measure_parts
from fem_snh.terms.feature import Feature, create_terms
from fem_snh.terms.mean_volume import volume_term
from fem_snh.terms.ufl_term import UFLTerm

Array = npt.NDArray[Any]

#: Size below which the value of a basis function at a node is rounding.
_ROUNDING = 1e-9


class LiftedConditions(Dirichlet):
    """The Dirichlet conditions of a program on another space: see `Dirichlet`. Collective.

    A node is constrained where a node of the program's space is that is, and on facets of the
    boundary and in cells all of whose nodes are. Its values are those of the displacement now.

    Parameters
    ----------
    conditions : DolfinxConditions
        The conditions on the program's space.
    u, lifted : dolfinx Function
        The displacement, and its interpolation in the other space.
    kinematics : Kinematics
        On a body of revolution the radial and rotational displacements are zero on the axis.

    """

    depends_on_load = False

    def __init__(
        self, conditions: DolfinxConditions, u: Any, lifted: Any, kinematics: Kinematics
    ) -> None:
        V, W = u.function_space, lifted.function_space
        nodes, components = _Nodes(V, W), _dolfinx.num_components(W)
        owned = _dolfinx.num_nodes(W)[0]
        self.constrained = np.zeros((sum(_dolfinx.num_nodes(W)), components), dtype=bool)
        planes = {
            label: facets_plane(W, facets, "bcs", "symmetry")
            for label, facets in conditions.symmetry.items()
        }
        self.conditions = conditions_of_planes(planes)
        for label, directions in conditions.conditions:
            if label not in planes:
                given = np.zeros_like(conditions.constrained)
                for of_component, normal in directions:
                    given[of_component, normal.argmax()] = True
                mask = _lifted_mask(V, W, nodes, given)
                self.constrained |= mask
                self.conditions.append(condition_of_mask(label, mask))
        if kinematics.revolved:
            self.constrained[axis_nodes(W)[:, None], kinematics.off_axis] = True
        self.planes = InclinedPlanes.of([*planes.values()], self.constrained, owned)
        self.dofs = np.flatnonzero(self.constrained[:owned])
        self._values = lifted.x.array.copy()

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set what is constrained of ``x`` to the program's values."""
        x.array[self.dofs] = self._values[self.dofs]
        if self.planes:
            self.planes.prescribe(x.array)


class FollowingConditions(LiftedConditions):
    """The Dirichlet conditions of a program on another space, with its values at each load."""

    def __init__(
        self, conditions: DolfinxConditions, u: Any, lifted: Any, kinematics: Kinematics
    ) -> None:
        super().__init__(conditions, u, lifted, kinematics)
        self.depends_on_load = conditions.depends_on_load
        self._conditions, V, W = conditions, u.function_space, lifted.function_space
        self._vector = _dolfinx.create_vector(V)
        self._given, self._lifted = _dolfinx.function(V, "given"), _dolfinx.function(W, "lifted")

    def set_load(self, load: float) -> None:
        """Set the program's constants, functions and boundary values."""
        self._conditions.set_load(load)

    def set_values(self, x: PETSc.Vec, load: float) -> None:
        """Set what is constrained of ``x`` to the program's values at a load. Collective."""
        self._conditions.set_values(self._vector, load)
        update_ghosts(self._vector)
        copy_to_function(self._vector, self._given)
        self._lifted.interpolate(self._given)
        self._values = self._lifted.x.array
        super().set_values(x, load)


class _Nodes:
    """How the nodes of two spaces on one cell lie to each other and to its facets.

    Attributes
    ----------
    same : (lifted nodes,) int
        The node of the first space at the same coordinates; -1: none.
    facets : list of (base nodes, lifted nodes)
        The numbers of the nodes on each facet.
    """

    def __init__(self, V: Any, W: Any) -> None:
        cell = _dolfinx.cell_name(V.mesh)
        nodes = [_dolfinx.reference_nodes(cell, _dolfinx.degree(space)) for space in (V, W)]
        distance = np.linalg.norm(nodes[1][:, None] - nodes[0][None], axis=2)
        self.same = np.where(distance.min(axis=1) < _ROUNDING, distance.argmin(axis=1), -1)
        self.facets = [*zip(_dolfinx.facet_nodes(V), _dolfinx.facet_nodes(W), strict=True)]


def _lifted_mask(V: Any, W: Any, nodes: _Nodes, mask: Array) -> Array:
    """Return the components of W's nodes that are constrained if V's are. Collective."""
    old, new = _dolfinx.node_dofs(V), _dolfinx.node_dofs(W)
    inside = mask[old]  # (cells, nodes, components)
    components = mask.shape[1]
    marks = np.zeros((sum(_dolfinx.num_nodes(W)), components))
    known = nodes.same >= 0
    np.maximum.at(marks, new[:, known], inside[:, nodes.same[known]].astype(float))
    whole = inside.all(axis=1)[:, None].astype(float)
    np.maximum.at(marks, new, np.broadcast_to(whole, (*new.shape, components)))
    _, cells, local = _dolfinx.exterior_facets(V.mesh)
    for number, (base, lifted) in enumerate(nodes.facets):
        on = cells[local == number]
        whole = inside[on][:, base].all(axis=1)[:, None].astype(float)
        targets = new[on][:, lifted]
        np.maximum.at(marks, targets, np.broadcast_to(whole, (*targets.shape, components)))
    return summed_over_ranks(W, marks) > 0


def lifted_problem(
    problem: Problem,
    element: Element,
    start: Any = None,
    motion: CreateMotion | None = None,
    duration: float | None = None,
) -> Problem:
    """Return the problem of a program with another element, at its state and load. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, made by `create_dolfinx_problem`.
    element : Element
        The other element, on the same cells.
    start : dolfinx Function, optional
        The displacement to begin from, on the program's space. Boundary values and forms then
        follow the load, as the program's do. Default: the solution, with its boundary values.
    motion, duration : optional
        As for `create_dolfinx_problem`.

    Raises
    ------
    BadInput
        On every rank, for a term of the program's own, which is made for its space.
    """
    kinematics = problem.kinematics
    V = _dolfinx.function_space(problem.domain, element.degree, (kinematics.components,))
    u = _dolfinx.function(V, "displacement")
    problem.split(problem.x)
    u.interpolate(problem.u if start is None else start)
    u.x.scatter_forward()
    assert isinstance(problem.dirichlet, DolfinxConditions)
    made_by = LiftedConditions if start is None else FollowingConditions
    conditions = made_by(problem.dirichlet, problem.u, u, kinematics)
    moving = motion(u, problem.regions, conditions, kinematics) if motion else None
    found = partial(measure_facets, problem.domain), partial(measure_parts, problem.domain)
    given = *found, Amplitudes((), duration), moving
    body = Body(u, problem.regions, conditions, *given, kinematics=kinematics)
    made = [
        _lifted_term(term, f"terms[{i}]", problem.u, u, conditions.depends_on_load)
        for i, term in enumerate(problem.given_terms)
    ]
    if problem.given_volume is not None:
        follows = conditions.depends_on_load
        made.append(volume_term(problem.given_volume, u, element, follows))
    terms = [*create_terms(made, body), *(moving.terms if moving else [])]
    unknowns = create_unknowns(u, element)
    lifted = Problem(unknowns, element, problem.regions, conditions, terms, motion=moving)
    displacement = u.x.array[: lifted.owned_displacements].copy()
    lifted.x.array[: len(displacement)] = displacement  # with a pressure, not the vector of u
    if not problem.regions:
        set_modulus(lifted)
    return lifted


def _lifted_term(term: Any, name: str, u: Any, lifted: Any, depends_on_load: bool) -> Any:
    """Return a feature as it is, and the term of a form in the other displacement."""
    if isinstance(term, Feature):
        return term
    if not isinstance(term, ufl.Form):
        raise BadInput(f"{name}, a term of the program, is made for its own space")
    V, W = u.function_space, lifted.function_space
    tests = {old: ufl.TestFunction(W) for old in term.arguments()}
    form = ufl.replace(term, {u: lifted} | tests)
    form = _integrated(form, 2 * (_dolfinx.degree(W) - _dolfinx.degree(V)))
    return UFLTerm(form, lifted, name, depends_on_load)


def _integrated(form: Any, more: int) -> Any:
    """Return a form whose given quadrature degrees are larger by ``more``.

    Those of the program's element would leave the lifted one modes without energy.
    """
    integrals = []
    for integral in form.integrals():
        metadata = dict(integral.metadata())
        degree = metadata.get("quadrature_degree")
        plain = all(metadata.get(key) in DEFAULT_RULES for key in RULE_KEYS)
        if plain and isinstance(degree, int | np.integer) and degree >= 0:
            metadata["quadrature_degree"] = int(degree) + more
        integrals.append(integral.reconstruct(metadata=metadata))
    return ufl.Form(integrals)
