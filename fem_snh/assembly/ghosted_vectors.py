"""Ghosted PETSc vectors: their local values, and the exchange of ghosts between ranks.

`fem_snh.assembly.unknowns`, the energy terms and the output's fields call it. PETSc's own
operations, ``Vec.set`` among them, leave the ghosts as they are.
"""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx

Array = npt.NDArray[Any]


def ghosted(V: Any, owned: Array) -> PETSc.Vec:
    """Return the ghosted vector of a space with the values of owned dofs. Collective."""
    vector = _dolfinx.create_vector(V)
    vector.array[:] = owned
    update_ghosts(vector)
    return vector


def with_ghosts(V: Any, owned: Array) -> Array:
    """Return the values of owned dofs of a space, and those of its ghosts, a copy. Collective."""
    vector = ghosted(V, owned)  # the values are its memory
    return np.array(local_values(vector))


def summed_over_ranks(V: Any, values: Array) -> Array:
    """Return the sums over ranks of values at local nodes, ghosts included. Collective.

    Parameters
    ----------
    V : dolfinx function space
    values : (local nodes, components) array
        This rank's part of the sums, zero at nodes of other ranks' cells alone.

    Returns
    -------
    (local nodes, components) array
    """
    vector = _dolfinx.create_vector(V)
    writable_values(vector)[:] = values.ravel()
    add_ghosts(vector)
    update_ghosts(vector)
    return np.array(local_values(vector)).reshape(values.shape)


def summed_over_cells(V: Any, values: Array, nodes: Array | None = None) -> Array:
    """Return the sums over cells of values at their nodes, ghosts included. Collective.

    Parameters
    ----------
    V : dolfinx function space
    values : (cells, nodes, components) array
        The values in cells of this rank.
    nodes : (cells, nodes) int, optional
        The local nodes of these cells; default: of all own cells.

    Returns
    -------
    (local nodes, components) array
    """
    sums = np.zeros((sum(_dolfinx.num_nodes(V)), _dolfinx.num_components(V)))
    np.add.at(sums, _dolfinx.node_dofs(V) if nodes is None else nodes, values)
    return summed_over_ranks(V, sums)


def nodes_of_other_cells(V: Any, cells: Array) -> Array:
    """Return which of this rank's own nodes belong to a cell beside its own ``cells``. Collective.

    Parameters
    ----------
    V : dolfinx function space
    cells : (n,) int
        Cells of each rank.

    Returns
    -------
    (owned nodes,) bool
    """
    nodes = np.delete(_dolfinx.node_dofs(V), cells, axis=0)
    marks = summed_over_cells(V, np.ones((*nodes.shape, 1)), nodes)
    return np.asarray(marks[: _dolfinx.num_nodes(V)[0], 0] > 0)


def local_values(vector: PETSc.Vec) -> Array:
    """Return a ghosted vector's local values to read while it exists, ghosts included."""
    with vector.localForm() as local:
        return np.asarray(local.array_r)


def writable_values(vector: PETSc.Vec) -> Array:
    """Return a ghosted vector's local values to write while it exists, ghosts included."""
    with vector.localForm() as local:
        return np.asarray(local.array)


def copy_to_function(vector: PETSc.Vec, function: Any) -> None:
    """Set a dolfinx function to a ghosted vector of its space, ghosts included."""
    function.x.array[:] = local_values(vector)


def set_to_zero(vector: PETSc.Vec) -> None:
    """Set a ghosted vector to zero, ghosts included."""
    with vector.localForm() as local:
        local.set(0.0)


def update_ghosts(vector: PETSc.Vec) -> None:
    """Copy owned values to the ghosts of other ranks. Collective."""
    vector.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)


def add_ghosts(vector: PETSc.Vec) -> None:
    """Add ghost values to those of the ranks that own them. Collective."""
    vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
