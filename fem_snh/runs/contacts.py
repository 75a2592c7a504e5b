"""The terms of a scene's contact tables, each made only if the scene names it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.regions import Region
from fem_snh.mesh.mesh import Mesh, volume
from fem_snh.scenes import Scene
from fem_snh.terms.body import group_facets
from fem_snh.terms.term import Term


def contact_terms(
    scene: Scene, mesh: Mesh, u: Any, regions: Sequence[Region], dirichlet: Dirichlet
) -> list[Term]:
    """Return the terms of contact. Collective.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or no surface.
    """
    V, terms = u.function_space, list[Term]()
    if scene.contact:
        from fem_snh.contact.body_contact import BodyContact
        from fem_snh.contact.surface_pair import BodyPair

        pairs = []
        for contact in scene.contact:
            first, second = (group_facets(mesh, "contact.groups", key) for key in contact.groups)
            tolerance = contact.absolute_tolerance(volume(mesh.domain))
            name, k = contact.name, contact.stiffness
            method = contact.augmented, tolerance, scene.time is None
            pairs.append(BodyPair(name, first, second, k, *method))
        terms.append(BodyContact(V, regions, pairs))
    if scene.self_contact:
        from fem_snh.contact.self_contact import SelfContact

        table = scene.self_contact
        choice = SelfContact(table.method, table.stiffness, table.distance, table.friction)
        terms.append(choice.create_term(V, regions, mesh))
    if scene.obstacle:
        from fem_snh.runs.obstacles import obstacle_contact

        terms.append(obstacle_contact(scene, mesh, V, regions))
    return terms
