"""The terms of a scene's loads, each made only if the scene names it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from fem_snh.assembly.boundary_conditions import Dirichlet
from fem_snh.assembly.regions import Region, reference_modulus
from fem_snh.errors import bad_value
from fem_snh.mesh.mesh import Mesh, volume
from fem_snh.scenes import Scene
from fem_snh.terms import Term
from fem_snh.terms.traction import surface_facets

if TYPE_CHECKING:
    from fem_snh.assembly.nodal_mass import NodalMass

#: Default stiffness of a fluid, in E over the body's volume: a pressure of E then compresses it by
#: a hundredth of the body's volume. A stiffer fluid shortens Newton's steps, as the volume is
#: nonlinear in the displacement.
_CAVITY_STIFFNESS = 100.0


def load_terms(
    scene: Scene,
    mesh: Mesh,
    u: Any,
    regions: Sequence[Region],
    dirichlet: Dirichlet,
    mass: NodalMass | None = None,
) -> list[Term]:
    """Return the terms of the load tables and of contact. Collective.

    Parameters
    ----------
    scene : Scene
        The scene.
    mesh : Mesh
        Its mesh.
    u : dolfinx Function
        The displacement.
    regions : sequence of Region
        The materials with their densities.
    dirichlet : Dirichlet
        The constrained dofs.
    mass : NodalMass, optional
        The mass matrix of a body in motion.

    Raises
    ------
    BadInput
        On every rank, for a group that is unknown or no surface, or a missing density.
    """
    V, terms = u.function_space, list[Term]()
    if scene.traction:
        from fem_snh.terms.traction import Traction

        terms.append(Traction(V, mesh, scene.traction, scene.amplitudes(scene.traction)))
    if scene.gravity:
        from fem_snh.terms.gravity import Gravity

        amplitude = scene.amplitudes([scene.gravity])[0]
        terms.append(Gravity(V, regions, scene.gravity.vector, amplitude, mass))
    if scene.pressure:
        from fem_snh.terms.pressure import Pressure

        amplitudes = scene.amplitudes(scene.pressure)
        terms.append(Pressure(u, mesh, scene.pressure, amplitudes, dirichlet))
    if scene.spring:
        from fem_snh.terms.spring import Spring

        constant = [None if s.table is None else scene.amplitudes([s])[0] for s in scene.spring]
        terms.append(Spring(u, mesh, scene.spring, constant))
    if scene.contact:
        from fem_snh.contact.body_contact import BodyContact
        from fem_snh.contact.surface_pair import BodyPair

        pairs = []
        for contact in scene.contact:
            first, second = (surface_facets(mesh, "contact.groups", key) for key in contact.groups)
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
    if scene.cavity:
        _check_cavities(mesh, [fluid.group for fluid in scene.cavity])
    for fluid in scene.cavity:
        from fem_snh.terms.cavity import Cavity

        stiffness = fluid.stiffness
        if stiffness is None:
            stiffness = _CAVITY_STIFFNESS * reference_modulus(mesh.domain, regions)
            stiffness /= volume(mesh.domain)
        amplitude = scene.amplitudes([fluid])[0]
        terms.append(Cavity(u, mesh, fluid, amplitude, stiffness, dirichlet))
    if scene.obstacle:
        from fem_snh.runs.obstacles import obstacle_contact

        terms.append(obstacle_contact(scene, mesh, V, regions))
    return terms


def _check_cavities(mesh: Mesh, keys: Sequence[str | int]) -> None:
    """Raise BadInput on every rank if the surfaces of two cavities share a facet. Collective."""
    facets = [surface_facets(mesh, "cavity.group", key) for key in keys]
    for (first, a), (second, b) in combinations(zip(keys, facets, strict=True), 2):
        if shared := mesh.domain.comm.allreduce(len(np.intersect1d(a, b))):
            accepted = f"a surface that shares no facet with that of cavity {first!r}, not {shared}"
            raise bad_value("cavity.group", second, accepted)
