"""The problem of a scene: a gmsh mesh with conditions on its physical groups."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any

from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import (
    Constraint,
    Dirichlet,
    DirichletConditions,
    PrescribedDisplacement,
    SymmetryPlane,
)
from fem_snh.assembly.elements import CELLS, Element, names_for
from fem_snh.assembly.regions import Filling, Region, regions_of_groups
from fem_snh.assembly.unknowns import create_unknowns
from fem_snh.choices import DEFAULT_ASSEMBLY
from fem_snh.errors import bad_value
from fem_snh.kernels.material import Material
from fem_snh.mesh.mesh import Mesh
from fem_snh.mesh.mesh_checks import check_half_plane
from fem_snh.problem.measures import group_cells
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import ReactionGroup, Reactions
from fem_snh.problem.solids import cells_in_shapes
from fem_snh.tables.amplitudes import LOAD_ITSELF, Amplitudes
from fem_snh.terms.body import Body, CreateMotion, group_entities, group_facets
from fem_snh.terms.feature import Feature, create_terms
from fem_snh.terms.term import Term

if TYPE_CHECKING:
    from fem_snh.problem.bones import BoneNodes


def create_problem(
    mesh: Mesh,
    element: Element,
    material: Material | Sequence[Filling],
    *,
    hold: Sequence[Constraint] = (),
    move: Sequence[PrescribedDisplacement] = (),
    symmetry: Sequence[SymmetryPlane] = (),
    bones: Callable[[Any, Mesh], Sequence[BoneNodes]] | None = None,
    features: Sequence[Feature | Term] = (),
    amplitudes: Amplitudes = LOAD_ITSELF,
    motion: CreateMotion | None = None,
    loads: Callable[[Mesh, Any, Sequence[Region], Dirichlet], Sequence[Term]] | None = None,
    reactions: Sequence[str | int | ReactionGroup] = (),
    volumes: Sequence[str | int] = (),
    assembly: str = DEFAULT_ASSEMBLY,
    hollow: bool = False,
) -> Problem:
    """Return a problem whose conditions name physical groups of its mesh. Collective.

    Parameters
    ----------
    mesh : Mesh
        The body in its reference configuration.
    element : Element
        The finite element; its cell must be the mesh's.
    material : Material or sequence of Filling
        The material of the whole body, or several with the physical groups that they fill.
    hold : sequence of Constraint, optional
        Components of the displacement that are zero on physical groups.
    move : sequence of PrescribedDisplacement, optional
        Components of the displacement that follow the load on physical groups.
    symmetry : sequence of SymmetryPlane, optional
        Plane physical groups in which nodes slide.
    bones : callable, optional
        Returns displacements of nodes, given the displacement's space and the mesh.
    features : sequence of Feature or Term, optional
        What makes terms beside the elastic energy: loads and contact.
    amplitudes : Amplitudes, optional
        The tables that they may name, and the time of load 1.
    motion : callable, optional
        Returns the motion in time of a body: `fem_snh.terms.body.CreateMotion`.
    loads : callable, optional
        Returns further terms, given mesh, displacement, regions and Dirichlet conditions.
    reactions : sequence of str, int or ReactionGroup, optional
        Physical groups whose reaction forces `Problem.reactions` returns, with the points of their
        moments.
    volumes : sequence of str or int, optional
        Physical groups of volumes whose volume ratios `Problem.measures` returns.
    assembly : str, optional
        What evaluates the elastic energy and its residual, one of `fem_snh.choices.ASSEMBLIES`.
    hollow : bool, optional
        Whether cells inside of bones that are shapes are not assembled.

    Raises
    ------
    BadInput
        On every rank, if mesh, element, material and physical groups do not fit together.
    """
    if mesh.cell != element.cell:
        fitting = ", ".join(names_for(mesh.cell))
        raise bad_value(
            "element", element.name, f"one of {fitting}: the mesh has {CELLS[mesh.cell]}"
        )
    domain = mesh.domain
    kinematics = element.kinematics
    if kinematics.revolved:
        check_half_plane(domain, "mesh")
    V = _dolfinx.function_space(domain, element.degree, (kinematics.components,))
    fillings = [Filling(material)] if isinstance(material, Material) else material
    regions = regions_of_groups(mesh, fillings)
    u = _dolfinx.function(V, "displacement")
    placed = bones(V, mesh) if bones else ()
    dirichlet = DirichletConditions(V, mesh, hold, move, placed, kinematics, symmetry)
    if hollow:
        dirichlet.solid_cells = cells_in_shapes(V, placed)
    moving = motion(u, regions, dirichlet, kinematics) if motion else None
    facets = partial(group_facets, mesh)
    entities = partial(group_entities, mesh)
    found = facets, entities, amplitudes, moving, mesh.skin, kinematics
    body = Body(u, regions, dirichlet, *found)
    terms = create_terms(features, body)
    terms += loads(mesh, u, regions, dirichlet) if loads else []
    return Problem(
        create_unknowns(u, element),
        element,
        regions,
        dirichlet,
        [*terms, *(moving.terms if moving else [])],
        Reactions(V, mesh, kinematics, dirichlet, reactions) if reactions else None,
        group_cells(mesh, volumes),
        assembly,
        moving,
        mesh.skin,
    )


def with_element(problem: Problem, element: Element) -> Problem:
    """Return the same problem with another element of the same displacement space. Collective.

    It has a displacement of its own. Both share their conditions and terms, which must keep nothing
    from one evaluation to the next.
    """
    unknowns = create_unknowns(_dolfinx.function(problem.V, "displacement"), element)
    others = problem.terms[1:]
    return Problem(unknowns, element, problem.regions, problem.dirichlet, others)
