"""Some nodes of a distributed body, whose values every rank has."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx

Array = npt.NDArray[Any]


class GatheredNodes:
    """Nodes of a displacement space, in the same order on all ranks. Collective.

    Parameters
    ----------
    V : dolfinx function space
        The displacement's space.
    nodes : (n,) int64
        Global nodes of V, of any rank, in any order; all ranks together give the nodes.

    Attributes
    ----------
    nodes : (m,) int64
        The global nodes, sorted, each once.
    is_own : (m,) bool
        Whether this rank owns the node.
    X : (m, 3)
        Their reference coordinates [m].
    """

    def __init__(self, V: Any, nodes: Array) -> None:
        self._V, self.comm = V, V.mesh.comm  # the mesh frees its communicator
        numbers, owned = _dolfinx.local_to_global(V), _dolfinx.num_nodes(V)[0]
        self.nodes = np.unique(np.concatenate(self.comm.allgather(np.unique(nodes))))
        # Global numbers of a rank's own nodes are contiguous.
        first = int(numbers[0]) if owned else 0
        self.is_own = (self.nodes >= first) & (self.nodes < first + owned)
        self._own = self.nodes[self.is_own] - first
        self.X = self.gather(V.tabulate_dof_coordinates()[:owned])

    def gather(self, values: Array) -> Array:
        """Return nodal values (local nodes, 3) of all the nodes, (m, 3). Collective."""
        # The nodes are sorted and each rank's own ones contiguous: the ranks follow each other.
        return np.concatenate(self.comm.allgather(np.array(values[self._own])))

    def add_own(self, values: Array, out: Array) -> None:
        """Add those of the nodes' values (m, 3) that this rank owns to ``out`` (local nodes, 3)."""
        out[self._own] += values[self.is_own]
