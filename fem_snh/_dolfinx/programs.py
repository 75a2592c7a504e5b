"""Read the objects of a user's program: function spaces, Dirichlet conditions, measures.

`fem_snh.NonlinearProblem` checks its arguments with these functions.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem
from dolfinx.fem import FunctionSpace

from fem_snh._dolfinx.meshes import exterior_facets, num_owned
from fem_snh.arrays import Array


def is_function(u: Any) -> bool:
    """Return whether ``u`` is a dolfinx Function."""
    return isinstance(u, fem.Function)


def is_lagrange(V: FunctionSpace) -> bool:
    """Return whether V's element is a continuous Lagrange element, or a vector of one."""
    element = V.ufl_element()
    # a method in 0.5, a property under another name since 0.7
    family = element.family_name if hasattr(element, "family_name") else element.family()
    return family in ("P", "Q", "Lagrange") and not getattr(element, "discontinuous", False)


def bc_space_is_within(bc: Any, V: FunctionSpace) -> bool:
    """Return whether a Dirichlet condition is on V or on a component of V."""
    space, parent = (getattr(s, "_cpp_object", s) for s in (bc.function_space, V))
    return bool(space == parent or parent.contains(space))


def bc_dofs(bc: Any) -> Array:
    """Return the dofs of a Dirichlet condition on this rank, ghosts included, (n,) int32."""
    return np.asarray(bc.dof_indices()[0])


def set_bcs(values: Array, bcs: Sequence[Any]) -> None:
    """Set entries of an array of owned dofs to the conditions' present values, in order."""
    for bc in bcs:
        if hasattr(bc, "set"):  # since 0.9
            bc.set(values)
        else:
            fem.set_bc(values, [bc])


def measure_entities(measure: Any, domain: Any) -> Array:
    """Return the owned cells of a ``dx``, or the exterior facets of a ``ds``, sorted (n,) int32.

    Raises
    ------
    ValueError
        If the measure has a subdomain but no data that says which entities are in it.
    """
    if measure.subdomain_id() == "everywhere":
        return _known(measure, domain)
    return np.unique(np.concatenate([np.empty(0, np.int32), *_tagged(measure, domain).values()]))


def count_entities(integral: Any, domain: Any) -> dict[int, int]:
    """Return the number of this rank's entities in each of an integral's subdomains.

    Keys are subdomain numbers. Entities are cells of a ``dx``, exterior facets of a ``ds``. Without
    subdomains the result is empty.

    Raises
    ------
    ValueError
        If the integral has subdomains but no data that says which entities are in them.
    """
    if integral.subdomain_id() in ("everywhere", "otherwise", ("everywhere",), ("otherwise",)):
        return {}
    return {number: len(entities) for number, entities in _tagged(integral, domain).items()}


def _known(measure: Any, domain: Any) -> Array:
    """Return all owned cells for a ``dx``, all exterior facets for a ``ds``, sorted (n,) int32."""
    if measure.integral_type() == "cell":
        return np.arange(num_owned(domain), dtype=np.int32)
    return exterior_facets(domain)[0]


def _ids(measure: Any) -> list[int]:
    """Return the numbers of a measure's or an integral's subdomains; ValueError if not numbers."""
    try:
        return [int(i) for i in np.atleast_1d(np.asarray(measure.subdomain_id(), dtype=object))]
    except (TypeError, ValueError):
        raise ValueError("a measure of numbered subdomains") from None


def _tagged(measure: Any, domain: Any) -> dict[int, Array]:
    """Return this rank's entities of subdomains by number; raise ValueError if no data has them."""
    data, of_cells = measure.subdomain_data(), measure.integral_type() == "cell"
    dim = domain.topology.dim - (not of_cells)
    kind, ids, known = "cells" if of_cells else "facets", _ids(measure), _known(measure, domain)
    found: dict[int, Array]
    if hasattr(data, "indices"):  # meshtags
        if data.dim != dim:
            raise ValueError(f"meshtags of {kind}")
        indices, values = np.asarray(data.indices), np.asarray(data.values)
        found = {i: indices[values == i] for i in ids}
    else:
        raise ValueError(f"a measure with subdomain_data (meshtags of the {kind})")
    return {i: entities[np.isin(entities, known)].astype(np.int32) for i, entities in found.items()}


def is_measure(measure: Any, facets: bool = False) -> bool:
    """Return whether an object is a UFL measure of cells (dx), or of exterior ``facets`` (ds)."""
    kinds = ("cell", "exterior_facet")[: 1 + facets]
    return isinstance(measure, ufl.Measure) and measure.integral_type() in kinds


def mesh_dimension(domain: Any) -> tuple[int, int]:
    """Return the dimensions of a mesh's cells and of its coordinates."""
    return int(domain.topology.dim), int(domain.geometry.dim)


def has_real_values(u: fem.Function) -> bool:
    """Return whether a function has real values in double precision."""
    return bool(u.x.array.dtype == np.float64)
