"""What a problem is made of: a mesh, materials, conditions and terms, of a scene or a program."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly.elements import CELLS, Element, names_for
from fem_snh.assembly.regions import Filling, fill_regions, owned_cells
from fem_snh.assembly.unknowns import create_unknowns
from fem_snh.choices import DEFAULT_ASSEMBLY
from fem_snh.errors import BadInput, bad_value
from fem_snh.mesh.mesh import Mesh
from fem_snh.mesh.mesh_checks import check_half_plane
from fem_snh.problem.conditions import LiftedValues, place_conditions
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import ReactionGroup, Reactions
from fem_snh.problem.regime import set_modulus
from fem_snh.tables.amplitudes import LOAD_ITSELF, Amplitudes
from fem_snh.terms.body import Body, CreateMotion
from fem_snh.terms.feature import Feature, create_terms
from fem_snh.terms.mean_volume import VolumeEnergy, volume_term
from fem_snh.terms.ufl_term import UFLTerm

if TYPE_CHECKING:
    from fem_snh.geometry.motions import Bone

#: Keys of a measure's metadata that name a quadrature rule, and the values of the default one.
RULE_KEYS = ("quadrature_rule", "quadrature_scheme")
DEFAULT_RULES = (None, "", "default")


@dataclass(frozen=True)
class Definition:
    """What a problem is made of, from which it is made again: in another element, at another nu.

    Attributes
    ----------
    mesh : Mesh
        The body in its reference configuration. That of a program has no physical groups.
    element : Element
        The finite element; its cell must be the mesh's.
    fillings : sequence of Filling
        The materials with the groups that they fill.
    conditions : sequence of Hold, Move, Symmetry or dolfinx DirichletBC, optional
        The Dirichlet conditions: see `fem_snh.problem.conditions.place_conditions`.
    terms : sequence of Feature, ufl.Form or Term, optional
        What acts beside the elastic energy: loads and contact; energies and residuals.
    u : dolfinx Function, optional
        The displacement of a program, in which its forms are written.
    volume : callable, optional
        A volume energy: see `fem_snh.terms.mean_volume.volume_term`.
    bones : sequence of Bone, optional
        The bones, whose nodes follow them.
    amplitudes : Amplitudes, optional
        The tables that features may name, and the time of load 1.
    motion : callable, optional
        Returns the motion in time of a body: `fem_snh.terms.body.CreateMotion`.
    on_load : callable, optional
        ``on_load(load)`` sets a program's constants, functions and boundary values.
    reactions : sequence of str, int or ReactionGroup, optional
        Groups whose reaction forces `Problem.reactions` returns, with the points of their moments.
    volumes : sequence of str or int, optional
        Groups of cells whose volume ratios `Problem.measures` returns.
    assembly : str, optional
        What evaluates the elastic energy and its residual, one of `fem_snh.choices.ASSEMBLIES`.
    """

    mesh: Mesh
    element: Element
    fillings: Sequence[Filling]
    conditions: Sequence[Any] = ()
    terms: Sequence[Any] = ()
    u: Any = None
    volume: VolumeEnergy | None = None
    bones: Sequence[Bone] = ()
    amplitudes: Amplitudes = LOAD_ITSELF
    motion: CreateMotion | None = None
    on_load: Callable[[float], None] | None = None
    reactions: Sequence[str | int | ReactionGroup] = ()
    volumes: Sequence[str | int] = ()
    assembly: str = DEFAULT_ASSEMBLY

    def problem(
        self, element: Element | None = None, u: Any = None, lifted: LiftedValues | None = None
    ) -> Problem:
        """Return the problem, with another element or displacement if one is given. Collective.

        In an element of a higher degree than the definition's, cells inside of bones that are
        shapes are not assembled.

        Parameters
        ----------
        element : Element, optional
            The other element, on the same cells.
        u : dolfinx Function, optional
            The displacement. Default: that of the program, otherwise a new one.
        lifted : LiftedValues, optional
            The values of the conditions of dolfinx, if ``u`` is in another space than theirs.

        Raises
        ------
        BadInput
            On every rank, if mesh, element, materials, groups and terms do not fit together.
        """
        element, mesh = element or self.element, self.mesh
        if mesh.cell != element.cell:
            fitting = f"one of {', '.join(names_for(mesh.cell))}: the mesh has {CELLS[mesh.cell]}"
            raise bad_value("element", element.name, fitting)
        kinematics = element.kinematics
        if kinematics.revolved:
            check_half_plane(mesh.domain, "mesh" if self.u is None else "u.function_space.mesh")
        u = self.u if u is None else u
        if u is None:
            V = _dolfinx.function_space(mesh.domain, element.degree, (kinematics.components,))
            u = _dolfinx.function(V, "displacement")
        V, bones = u.function_space, []
        if self.bones:
            from fem_snh.problem.bones import place_bones

            bones = place_bones(V, mesh, self.bones)
        regions = fill_regions(mesh, self.fillings)
        placed = self.conditions, kinematics, bones, self.on_load, lifted, self.amplitudes
        dirichlet = place_conditions(V, mesh, *placed)
        motion = self.motion(u, regions, dirichlet, kinematics) if self.motion else None
        body = Body(u, mesh, regions, dirichlet, self.amplitudes, motion, kinematics)
        follows = dirichlet.depends_on_load
        made = [self._term(term, f"terms[{i}]", u, follows) for i, term in enumerate(self.terms)]
        terms = create_terms(made, body)
        if self.volume is not None:
            terms.append(volume_term(self.volume, u, element, follows))
        if not regions and not any(term.has_hessian for term in terms):
            raise bad_value("materials", {}, "a material, or a term that is not linear in u")
        problem = Problem(
            create_unknowns(u, element),
            element,
            regions,
            dirichlet,
            [*terms, *(motion.terms if motion else [])],
            Reactions(V, mesh, kinematics, dirichlet, self.reactions) if self.reactions else None,
            {str(key): owned_cells(mesh, "volumes", key) for key in self.volumes},
            self.assembly,
            motion,
            mesh.skin,
        )
        problem.definition = self
        if not regions:
            set_modulus(problem)
        return problem

    def _term(self, term: Any, name: str, u: _dolfinx.Function, depends_on_load: bool) -> Any:
        """Return a feature or a term as it is, and the term of a form. Collective."""
        if isinstance(term, ufl.Form):
            form = term if u is self.u else _form_of(term, self.u, u)
            return UFLTerm(form, u, name, depends_on_load)
        if u is not self.u and self.u is not None and not isinstance(term, Feature):
            raise BadInput(f"{name}, a term of the program, is made for its own space")
        return term


def lifted_problem(problem: Problem, element: Element, start: Any = None) -> Problem:
    """Return the problem of a program with another element, at its state and load. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    element : Element
        The other element, on the same cells.
    start : dolfinx Function, optional
        The displacement to begin from, on the problem's space. Boundary values and forms then
        follow the load, as the program's do, and the body moves in time if the program's does.
        Default: the solution, with its boundary values.

    Raises
    ------
    BadInput
        On every rank, for a term of the program's own, which is made for its space.
    """
    definition, components = problem.definition, problem.kinematics.components
    V = _dolfinx.function_space(problem.domain, element.degree, (components,))
    u = _dolfinx.function(V, "displacement")
    problem.split(problem.x)
    u.interpolate(problem.u if start is None else start)
    u.x.scatter_forward()
    state = u if start is None else None
    if start is None:
        definition = replace(definition, on_load=None, motion=None)
    values = LiftedValues(problem.dirichlet, problem.V, V, state)
    lifted = definition.problem(element, u, values)
    displacement = u.x.array[: lifted.owned_displacements].copy()
    lifted.x.array[: len(displacement)] = displacement  # with a pressure, not the vector of u
    return lifted


def _form_of(form: Any, u: _dolfinx.Function, other: Any) -> Any:
    """Return a form of another displacement, of a higher degree.

    Given quadrature degrees grow with it: those of the program's element would leave the lifted one
    modes without energy.
    """
    V, W = u.function_space, other.function_space
    tests = {old: ufl.TestFunction(W) for old in form.arguments()}
    more, integrals = 2 * (_dolfinx.degree(W) - _dolfinx.degree(V)), []
    for integral in ufl.replace(form, {u: other} | tests).integrals():
        metadata = dict(integral.metadata())
        degree = metadata.get("quadrature_degree")
        plain = all(metadata.get(key) in DEFAULT_RULES for key in RULE_KEYS)
        if plain and isinstance(degree, int | np.integer) and degree >= 0:
            metadata["quadrature_degree"] = int(degree) + more
        integrals.append(integral.reconstruct(metadata=metadata))
    return ufl.Form(integrals)
