"""The definition of a problem, from a scene or a program, and checks of a program's arguments."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import ufl

from fem_snh import _dolfinx
from fem_snh.assembly import elements
from fem_snh.assembly.elements import CELLS, ELEMENTS, MAX_QUADRATURE_DEGREE, Element, names_for
from fem_snh.assembly.kinematics import PLANE_CELLS, Kinematics, find_kinematics
from fem_snh.assembly.regions import Filling, fill_regions, owned_cells
from fem_snh.assembly.unknowns import create_unknowns, space_for
from fem_snh.errors import BadInput, bad_value, check_whole, unknown_name
from fem_snh.kernels.material import Material
from fem_snh.mesh.mesh import Mesh
from fem_snh.mesh.mesh_checks import check_geometry, check_half_plane
from fem_snh.problem.conditions import LiftedValues, place_conditions
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import ReactionGroup, Reactions
from fem_snh.problem.regime import set_modulus
from fem_snh.tables.amplitudes import LOAD_ITSELF, Amplitudes
from fem_snh.terms.body import Body, CreateMotion
from fem_snh.terms.dirichlet import Symmetry
from fem_snh.terms.feature import Feature, create_terms, grouped
from fem_snh.terms.mean_volume import VolumeEnergy, volume_term
from fem_snh.terms.term import Term
from fem_snh.terms.ufl_term import TERM, UFLTerm, check_form

if TYPE_CHECKING:
    from fem_snh.geometry.motions import Bone


#: Keys of a measure's metadata that name a quadrature rule, and their values for the default rule.
RULE_KEYS = ("quadrature_rule", "quadrature_scheme")
DEFAULT_RULES = (None, "", "default")


@dataclass(frozen=True)
class Definition:
    """All data of a problem, from which `problem` creates it, in one element or several.

    Attributes
    ----------
    mesh : Mesh
        The body in its reference configuration. A program may give a mesh without physical groups.
    element : Element
        The finite element; its cell must be the mesh's.
    fillings : sequence of Filling
        The materials with the groups that they fill.
    conditions : sequence of Hold, Move, Symmetry or dolfinx DirichletBC, optional
        The Dirichlet conditions: see `fem_snh.problem.conditions.place_conditions`.
    terms : sequence of Feature, ufl.Form or Term, optional
        The loads, contacts, energies and residuals that act beside the elastic energy.
    u : dolfinx Function, optional
        The displacement of a program, a coefficient of its forms. Default: of a scene, none.
    volume : callable, optional
        A volume energy: see `fem_snh.terms.mean_volume.volume_term`.
    bones : sequence of Bone, optional
        The bones, which prescribe the displacement of the nodes in them.
    amplitudes : Amplitudes, optional
        The tables that features may name, and the time of load 1.
    motion : callable, optional
        Creates the motion of a body in time: `fem_snh.terms.body.CreateMotion`. Default: statics.
    on_load : callable, optional
        ``on_load(load)`` sets a program's constants, functions and boundary values.
    reactions : sequence of str, int or ReactionGroup, optional
        Groups whose reaction forces `Problem.reactions` returns; a ReactionGroup may have a point
        of the moment.
    volumes : sequence of str or int, optional
        Groups of cells whose volume ratios `Problem.measures` returns.
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

    def problem(
        self, element: Element | None = None, u: Any = None, lifted: LiftedValues | None = None
    ) -> Problem:
        """Create the problem. Collective.

        Parameters
        ----------
        element : Element, optional
            Another element on the same cells. Default: the definition's.
        u : dolfinx Function, optional
            The displacement. Default: the program's, or for a scene a new Function.
        lifted : LiftedValues, optional
            Transfers dolfinx conditions to the space of ``u``, if they are on another space.

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
            V = space_for(mesh.domain, element, kinematics.components)
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
            motion,
            mesh.skin,
        )
        problem.definition = self
        if not regions:
            set_modulus(problem)
        return problem

    def _term(self, term: Any, name: str, u: _dolfinx.Function, depends_on_load: bool) -> Any:
        """Return the `UFLTerm` of a form, in ``u``; otherwise ``term`` as it is. Collective.

        It raises BadInput for a `fem_snh.Term` if ``u`` is not the program's displacement.
        """
        if isinstance(term, ufl.Form):
            form = term if u is self.u else _form_of(term, self.u, u)
            return UFLTerm(form, u, name, depends_on_load)
        if u is not self.u and self.u is not None and not isinstance(term, Feature):
            raise BadInput(f"{name}, a term of the program, is made for its own space")
        return term


def lifted_problem(problem: Problem, element: Element, start: Any = None) -> Problem:
    """Return a program's problem in another element, at the same state and load. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.
    element : Element
        The other element, on the same cells.
    start : dolfinx Function, optional
        The displacement at which a path begins, on the problem's space: boundary values and forms
        depend on the load, and the body moves in time, as in the program. Default: the state is the
        present solution, interpolated, and its boundary values are constant.

    Raises
    ------
    BadInput
        On every rank, if the program gave a `fem_snh.Term` object, which belongs to one space.
    """
    definition, components = problem.definition, problem.kinematics.components
    V = space_for(problem.domain, element, components)
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
    """Return a form with ``u`` replaced by ``other``, a displacement of a higher degree.

    Explicit quadrature degrees increase by twice the difference of the degrees: with the program's
    quadrature the higher element has modes without energy.
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


#: UFL's measures by the type of an integral, and the entities that they integrate over.
_SYMBOLS = {"cell": "dx", "exterior_facet": "ds"}
_ENTITIES = {"dx": "cells", "ds": "facets of the boundary"}
#: The accepted value of ``densities``, for messages.
DENSITIES = "{material: density > 0}"


def define(
    u: _dolfinx.Function,
    materials: Mapping[Material, Any],
    bcs: Sequence[Any] | None = None,
    terms: Sequence[Any] | None = (),
    element: str | None = None,
    densities: Mapping[Material, float] | None = None,
    volume: VolumeEnergy | None = None,
    kinematics: str | None = None,
    mesh: Mesh | None = None,
    bones: Sequence[Bone] = (),
    amplitudes: Amplitudes | None = None,
    quadrature: int | None = None,
    *,
    on_load: Callable[[float], None] | None = None,
    motion: CreateMotion | None = None,
    integrator: str = "",
    duration: float | None = None,
) -> Definition:
    """Check the arguments of a dolfinx program; return the definition of its problem. Collective.

    Parameters
    ----------
    u, materials, bcs, terms, element, densities, volume, kinematics, mesh, bones, \
    amplitudes, quadrature
        The arguments of `fem_snh.NonlinearProblem`.
    on_load, motion : callable, optional
        As for `Definition`.
    integrator : str, optional
        The name of the time integrator; empty in statics.
    duration : float, optional
        The time of load 1 [s]; None in statics.

    Raises
    ------
    BadInput
        On every rank, for arguments of a wrong type or that contradict each other.
    """
    chosen = check_displacement(u, kinematics)
    check_materials(materials, mesh)
    bcs = _listed("bcs", bcs, "a list of conditions, [dolfinx.fem.dirichletbc(...), ...]")
    terms = _listed("terms", terms, f"a list of terms, each {TERM}")
    domain = u.function_space.mesh
    kind = _element(u, element, materials, quadrature, chosen)
    if mesh is None:
        check_geometry(domain, "u.function_space.mesh")
        mesh = Mesh(domain, kind.cell, (), _dolfinx.num_cells(domain))
    elif mesh.domain is not domain:
        raise bad_value("mesh", "another mesh", "the mesh of the displacement, with its groups")
    densities = _checked(densities, materials)
    fillings = [Filling(m, measure, densities.get(m)) for m, measure in materials.items()]
    for number, term in enumerate(terms):
        _check_term(term, f"terms[{number}]", u)
    _check_features(terms, kind, integrator)
    if not fillings and kind.pressure_degree:
        raise bad_value("element", kind.name, "an element without a pressure, without materials")
    if volume is None and not (fillings or terms):
        raise bad_value("materials", materials, "a material, or a term that is not linear in u")
    given: dict[str, Any] = {"on_load": on_load, "motion": motion, "volume": volume, "u": u}
    given |= {"bones": bones, "amplitudes": amplitudes or Amplitudes((), duration)}
    return Definition(mesh, kind, fillings, list(bcs), list(terms), **given)


class _ProgramKeys(SimpleNamespace):
    """A program in place of the scene that `Feature.check` takes; keys not given are None."""

    def __getattr__(self, key: str) -> None:
        return None


def _check_features(terms: Sequence[Any], element: Element, integrator: str) -> None:
    """Raise BadInput for features that contradict each other, the element or the integrator."""
    features = [term for term in terms if isinstance(term, Feature)]
    obstacles = [feature for feature in features if feature.key == "obstacle"]
    time = SimpleNamespace(integrator=integrator) if integrator else None
    keys = _ProgramKeys(element=element.name, time=time, obstacle=obstacles)
    for number, term in enumerate(terms):
        if element.kinematics.dim == 2 and isinstance(term, Feature | Term) and not term.planar:
            accepted = "no such term, on a mesh of 2 dimensions"
            raise bad_value(f"terms[{number}]", type(term).__name__, accepted)
    for kind, alike in grouped(features):
        kind.check(alike, keys)


def check_lists(problem: Problem, bcs: Sequence[Any] | None, terms: Sequence[Any] | None) -> None:
    """Raise BadInput unless the lists hold the objects that the problem was made of."""
    definition = problem.definition
    made_of = {"bcs": (bcs, definition.conditions), "terms": (terms, definition.terms)}
    for key, (present, given) in made_of.items():
        if [*map(id, present or ())] != [*map(id, given)]:
            accepted = "the list that the problem was made of: make a new one for another"
            raise bad_value(key, f"a list of {len(present or ())} that has changed", accepted)


def _check_term(term: Any, name: str, u: _dolfinx.Function) -> None:
    """Raise BadInput unless ``term`` is a feature, a term or a form of ``u``. Collective."""
    if isinstance(term, Feature | Term):
        return
    if isinstance(term, Symmetry):
        raise bad_value(name, term, f"{TERM}; a Symmetry is one of 'bcs'")
    check_form(term, u, name)
    _check_integrals(term, name, u.function_space.mesh)


def _checked(
    densities: Mapping[Material, float] | None, materials: Mapping[Material, Any]
) -> Mapping[Material, float]:
    """Return the densities, {} for None; raise BadInput for a key that is not in ``materials``."""
    densities = {} if densities is None else densities
    if not isinstance(densities, Mapping):
        raise bad_value("densities", densities, DENSITIES)
    if unknown := [key for key in densities if key not in materials]:
        raise bad_value("densities", unknown[0], "only keys of 'materials'")
    return densities


def check_displacement(u: _dolfinx.Function, name: str | None = None) -> Kinematics:
    """Return the kinematics of a displacement; ``name`` is its name, None in three dimensions.

    Raises
    ------
    BadInput
        Unless ``u`` is a real displacement of degree 1 or 2 with the kinematics' components.
    """
    if not _dolfinx.is_function(u):
        raise bad_value("u", u, "a dolfinx Function, the displacement")
    if not _dolfinx.has_real_values(u):
        accepted = "float64 (a PETSc configured with real numbers in double precision)"
        raise bad_value("u.x.array.dtype", str(u.x.array.dtype), accepted)
    V, domain = u.function_space, u.function_space.mesh
    dimension, cell = _dolfinx.mesh_dimension(domain), _dolfinx.cell_name(domain)
    kinds = sorted(PLANE_CELLS)
    if not (dimension == (3, 3) and cell in kinds) and not (
        dimension == (2, 2) and cell in PLANE_CELLS.values()
    ):
        found = f"{cell} cells in {dimension[1]} dimensions"
        accepted = f"{' or '.join(kinds)} cells in 3, or "
        accepted += f"{' or '.join(PLANE_CELLS.values())} cells in 2"
        raise bad_value("u.function_space.mesh", found, accepted)
    kinematics = find_kinematics(name, dimension[0])
    if (
        tuple(u.ufl_shape) != (kinematics.components,)
        or not _dolfinx.is_lagrange(V)
        or _dolfinx.degree(V) not in (1, 2)
    ):
        accepted = "a continuous Lagrange space of degree 1 or 2 with "
        accepted += f"{kinematics.components} components"
        raise bad_value("u.function_space", str(V.ufl_element()), accepted)
    if kinematics.revolved:
        check_half_plane(domain, "u.function_space.mesh")
    return kinematics


def check_materials(materials: Any, mesh: Mesh | None = None) -> None:
    """Raise BadInput unless ``materials`` maps materials to measures or, with a mesh, to groups."""
    accepted = "{fem_snh.material(...): a measure dx of cells}"
    if not isinstance(materials, Mapping):
        raise bad_value("materials", materials, accepted)
    for material, measure in materials.items():
        is_group = mesh is not None and isinstance(measure, str | int | None)
        if not isinstance(material, Material) or not (_dolfinx.is_measure(measure) or is_group):
            raise bad_value("materials", {material: measure}, accepted)


def _listed(key: str, values: Any, accepted: str) -> Sequence[Any]:
    """Return a list or a tuple, () for None; raise BadInput for anything else."""
    if values is None:
        return ()
    if not isinstance(values, Sequence) or isinstance(values, str):
        raise bad_value(key, values, accepted)
    return values


def _check_integrals(form: Any, name: str, domain: _dolfinx.Mesh) -> None:
    """Raise BadInput if a subdomain of a form has no cell or facet on any rank. Collective."""
    for integral in form.integrals():
        symbol = _SYMBOLS[integral.integral_type()]
        try:
            counts = _dolfinx.count_entities(integral, domain)
        except ValueError as error:
            raise bad_value(name, f"{symbol}({integral.subdomain_id()})", str(error)) from None
        totals = domain.comm.allreduce(np.array([*counts.values()], dtype=np.int64))
        for number, total in zip(counts, totals, strict=True):
            if total == 0:
                accepted = f"an integral over {_ENTITIES[symbol]}; none has the tag {number}"
                raise bad_value(name, f"{symbol}({number})", accepted)


def _element(
    u: _dolfinx.Function,
    name: str | None,
    materials: Mapping[Material, Any],
    quadrature: int | None,
    kinematics: Kinematics,
) -> Element:
    """Return the element ``name``, by default the first with the cell and the degree of ``u``.

    Its quadrature degree is the measures', else ``quadrature``. Raises BadInput if these differ.
    """
    V = u.function_space
    cell, degree = _dolfinx.cell_name(V.mesh), _dolfinx.degree(V)
    fitting = [other for other in names_for(cell) if ELEMENTS[other].degree == degree]
    if name is not None and name not in fitting:
        accepted = f"one of {', '.join(fitting)}, for a displacement of degree {degree} on "
        accepted += CELLS[cell]
        raise bad_value("element", name, accepted)
    measures = {m: measure for m, measure in materials.items() if _dolfinx.is_measure(measure)}
    degrees = {_quadrature_degree(m, measure) for m, measure in measures.items()} or {quadrature}
    if len(degrees) > 1:
        found = ", ".join(sorted(str(d) for d in degrees))
        raise bad_value("materials", f"quadrature degrees {found}", "the same for all measures")
    return elements.element(name or fitting[0], degrees.pop(), kinematics)


def _quadrature_degree(material: Material, measure: Any) -> Any:
    """Return the degree in a measure's metadata, or None; raise BadInput for other metadata."""
    known = {"quadrature_degree", *RULE_KEYS}
    key = f"materials[{material.name}].metadata"
    for name, value in measure.metadata().items():
        if name not in known:
            raise unknown_name(f"{key} key", name, ("quadrature_degree",))
        if name in RULE_KEYS and value not in DEFAULT_RULES:
            accepted = "'default': materials have the quadrature rule of their element"
            raise bad_value(f"{key}['{name}']", value, accepted)
    degree = measure.metadata().get("quadrature_degree")
    degree = degree.item() if isinstance(degree, np.integer) else degree
    if degree is not None:
        check_whole("quadrature_degree", degree, 1, MAX_QUADRATURE_DEGREE)
    return degree
