"""The connected parts of a mesh, or of some of its cells, on any number of ranks."""

from __future__ import annotations

import numpy as np

from fem_snh import _dolfinx
from fem_snh._dolfinx import FunctionSpace
from fem_snh.arrays import Array


def connected_parts(V: FunctionSpace, cells: Array | slice = slice(None)) -> tuple[Array, int]:
    """Return the part of each local node, (local nodes,) int, and the number of parts. Collective.

    Cells that share a node belong to one part. A part has the same number, from 0, on all ranks;
    nodes of no chosen cell on any rank get -1. Ranks exchange the labels of shared nodes only.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    cells : (n,) int, optional
        Cells that this rank owns. Default: all.
    """
    comm, numbers = V.mesh.comm, _dolfinx.local_to_global(V)
    nodes, ghosts = _dolfinx.node_dofs(V)[cells], numbers[_dolfinx.num_nodes(V)[0] :]
    used, at = np.unique(nodes, return_inverse=True)
    own, label = np.unique(components(at.reshape(nodes.shape), len(used)), return_inverse=True)
    labels = np.full(len(numbers), -1)
    labels[used] = label + (comm.exscan(len(own)) or 0)
    # A node of several ranks joins their labels.
    shared = (labels >= 0) & np.isin(numbers, np.concatenate(comm.allgather(ghosts)))
    pairs = np.concatenate(comm.allgather(np.column_stack([numbers, labels])[shared]))
    names, first, name = np.unique(pairs[:, 0], return_index=True, return_inverse=True)
    count = comm.allreduce(len(own))
    links = np.column_stack([pairs[:, 1], count + name])
    parts, number = np.unique(components(links, count + len(names)), return_inverse=True)
    known = np.isin(numbers, names)  # also nodes whose cells are all on other ranks
    labels[known] = pairs[first, 1][np.searchsorted(names, numbers[known])]
    return np.append(number, -1)[labels], len(parts)


def components(cells: Array, count: int) -> Array:
    """Return the smallest node that each of ``count`` nodes is connected to by ``cells``."""
    roots = np.arange(count)
    if not cells.size:
        return roots
    order = np.argsort(cells, axis=None, kind="stable")
    sorted_nodes, cell_of = cells.ravel()[order], order // cells.shape[1]
    starts = np.flatnonzero(np.diff(sorted_nodes, prepend=-1))
    nodes = sorted_nodes[starts]
    while True:
        smallest = roots[cells].min(axis=1)[cell_of]
        before = roots.copy()
        roots[nodes] = np.minimum(roots[nodes], np.minimum.reduceat(smallest, starts))
        roots = roots[roots]
        if np.array_equal(roots, before):
            return roots
