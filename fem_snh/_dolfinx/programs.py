"""Read the objects of a user's program: function spaces, Dirichlet conditions, measures.

`fem_snh.NonlinearProblem` checks its arguments with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import ufl
from dolfinx import fem

from fem_snh._dolfinx.meshes import num_owned

Array = np.ndarray


def is_function(u: Any) -> bool:
    """Return whether ``u`` is a dolfinx Function."""
    return isinstance(u, fem.Function)


def is_lagrange(V: Any) -> bool:
    """Return whether V's element is a continuous Lagrange element, or a vector of one."""
    element = V.ufl_element()
    # a method in 0.5, a property under another name since 0.7
    family = element.family_name if hasattr(element, "family_name") else element.family()
    return family in ("P", "Q", "Lagrange") and not getattr(element, "discontinuous", False)


def bc_space_is_within(bc: Any, V: Any) -> bool:
    """Return whether a Dirichlet condition is one on V or on a component of it."""
    space, parent = (getattr(s, "_cpp_object", s) for s in (bc.function_space, V))
    return bool(space == parent or parent.contains(space))


def bc_dofs(bc: Any) -> Array:
    """Return the dofs of a Dirichlet condition on this rank, ghosts included, (n,) int32."""
    return np.asarray(bc.dof_indices()[0])


def set_bcs(values: Array, bcs: Sequence[Any]) -> None:
    """Set the constrained entries of an array of owned dofs to their present values, in order."""
    for bc in bcs:
        if hasattr(bc, "set"):  # since 0.9
            bc.set(values)
        else:
            fem.set_bc(values, [bc])


def measure_cells(measure: Any, domain: Any) -> Array:
    """Return the cells of a ``dx`` measure that this rank owns, sorted (n,) int32.

    Raises
    ------
    ValueError
        If the measure has a subdomain but no data that says which cells are in it.
    """
    owned, ids = num_owned(domain), measure.subdomain_id()
    if ids == "everywhere":
        return np.arange(owned, dtype=np.int32)
    data = measure.subdomain_data()
    ids = [int(i) for i in np.atleast_1d(ids)]
    if hasattr(data, "indices"):  # meshtags
        if data.dim != 3:
            raise ValueError("meshtags of cells")
        cells = np.asarray(data.indices)[np.isin(data.values, ids)]
    elif isinstance(data, Sequence):  # (id, cells) pairs, since 0.8
        chosen = [np.asarray(entities) for i, entities in data if i in ids]
        cells = np.unique(np.concatenate([*chosen, np.empty(0, np.int32)]))
    else:
        raise ValueError("a measure with subdomain_data (meshtags of the cells)")
    return np.sort(cells[cells < owned]).astype(np.int32)


def is_measure(measure: Any) -> bool:
    """Return whether an object is a UFL measure of cells (dx)."""
    return isinstance(measure, ufl.Measure) and measure.integral_type() == "cell"


def mesh_dimension(domain: Any) -> tuple[int, int]:
    """Return the dimensions of a mesh's cells and of its coordinates."""
    return int(domain.topology.dim), int(domain.geometry.dim)


def has_real_values(u: Any) -> bool:
    """Return whether a function has real values in double precision."""
    return bool(u.x.array.dtype == np.float64)
