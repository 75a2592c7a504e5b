"""The contact of a scene's body with its obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.regions import Region
from fem_snh.contact.obstacle_contact import ObstacleContact, RigidContact
from fem_snh.errors import on_every
from fem_snh.mesh.mesh import Mesh, volume
from fem_snh.scenes import Scene, obstacle_names, read_obstacles
from fem_snh.terms.body import group_facets


def obstacle_terms(
    scene: Scene, mesh: Mesh, u: Any, regions: Sequence[Region], dirichlet: Dirichlet
) -> list[ObstacleContact]:
    """Return the term of the scene's obstacles. Collective.

    Raises
    ------
    BadInput
        On every rank, for a file that cannot be read, or a group that is unknown or no surface.
    """
    comm, size, contacts = mesh.domain.comm, volume(mesh.domain), []
    obstacles = on_every(comm, lambda: read_obstacles(scene.obstacle, scene.amplitudes))
    names = obstacle_names(scene.obstacle)
    for name, choice, obstacle in zip(names, scene.obstacle, obstacles, strict=True):
        key = choice.group
        facets = None if key is None else group_facets(mesh, "obstacle.group", key)
        contacts.append(
            RigidContact(
                name,
                obstacle,
                choice.friction,
                choice.stiffness,
                choice.absolute_tolerance(size),
                choice.augmented,
                facets,
                scene.time is None,
            )
        )
    term = ObstacleContact(u.function_space, regions, contacts)
    for pair in term.pairs:
        pair.linearised = scene.time is not None and scene.time.integrator == "semi_implicit"
    return [term]
