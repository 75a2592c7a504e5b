"""Groups of cells, facets, edges and nodes: physical groups of a mesh, or measures of UFL."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx
from fem_snh.errors import bad_value
from fem_snh.mesh.mesh import DIMENSIONS, Group, Mesh
from fem_snh.tables.types import surface_name

Array = npt.NDArray[Any]


def find_group(mesh: Mesh, key: str, given: Any) -> Group:
    """Return a physical group, by name or number, or what a measure is over. Collective.

    Parameters
    ----------
    mesh : Mesh
        The mesh; that of a dolfinx program has no physical groups.
    key : str
        The key of the group, for messages.
    given : str, int or ufl.Measure
        The group.

    Raises
    ------
    BadInput
        On every rank, for anything else, for an unknown group, and for a measure on another mesh or
        without entities.
    """
    if isinstance(given, str | int):
        if not mesh.groups:
            raise bad_value(key, given, "a measure ds(...): the mesh of a program has no groups")
        return mesh.group(given)
    domain, shown = mesh.domain, surface_name(given)
    if not _dolfinx.is_measure(given, facets=True):
        raise bad_value(key, shown, "a physical group, or a measure dx(...) or ds(...)")
    if given.ufl_domain() not in (None, domain.ufl_domain()):
        raise bad_value(key, "a measure on another mesh", "the mesh of the displacement")
    try:
        entities: Array = _dolfinx.measure_entities(given, domain)
    except ValueError as error:
        raise bad_value(key, shown, str(error)) from None
    of_cells = _dolfinx.is_measure(given)
    count = domain.comm.allreduce(len(entities))
    if count == 0:
        kind = "cells" if of_cells else "facets of the boundary"
        raise bad_value(key, shown, f"a measure of {kind}; none has this tag")
    return Group(shown, mesh.dim if of_cells else mesh.dim - 1, 0, entities, count)


def boundary_facets(mesh: Mesh, key: str, given: Any) -> Array:
    """Return this rank's facets of a surface of the body, (n,): see `find_group`. Collective.

    Raises
    ------
    BadInput
        On every rank, also for a group that is not a surface, or in part inside of the body: an
        integral over the boundary would leave that part out.
    """
    found = find_group(mesh, key, given)
    if found.dim != mesh.dim - 1:
        accepted = f"a {DIMENSIONS[mesh.dim - 1]}, not a {found.label}"
        raise bad_value(key, surface_name(given), accepted)
    exterior = _dolfinx.exterior_facets(mesh.domain)[0]
    outside = mesh.domain.comm.allreduce(int(np.isin(exterior, found.entities).sum()))
    if outside < found.count:
        inside = found.count - outside
        accepted = f"a surface of the body; {inside} of its {found.count} facets are inside of it"
        raise bad_value(key, given, accepted)
    return found.entities


def cells_or_facets(mesh: Mesh, key: str, given: Any) -> tuple[int, Array]:
    """Return dimension and entities of a group of cells or facets: see `find_group`. Collective.

    Raises
    ------
    BadInput
        On every rank, also for a group of edges or points.
    """
    found = find_group(mesh, key, given)
    if found.dim < mesh.dim - 1:
        accepted = f"a {DIMENSIONS[mesh.dim]} or a {DIMENSIONS[mesh.dim - 1]}, not a {found.label}"
        raise bad_value(key, given, accepted)
    return found.dim, found.entities


def owned_cells(mesh: Mesh, key: str, given: Any) -> Array:
    """Return this rank's own cells of a group of cells, (n,): see `find_group`. Collective.

    Raises
    ------
    BadInput
        On every rank, also for a group that is not of cells.
    """
    found = find_group(mesh, key, given)
    if found.dim != mesh.dim:
        accepted = f"a group of {DIMENSIONS[mesh.dim]}s, not a {found.label}"
        raise bad_value(key, surface_name(given), accepted)
    return found.entities[found.entities < _dolfinx.num_owned(mesh.domain)]
