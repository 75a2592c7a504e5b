"""The columns of a coarse space, and a matrix's product with them."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.linalg.block_matrix import Blocks

Array = npt.NDArray[Any]

#: Functions in a part: for each component of the displacement one constant, three linear.
MODES = 12


def bisect(places: Array, parts: int) -> Array:
    """(n,) the part, from 0 to ``parts`` - 1, of each of the nodes at ``places`` (n, 3).

    Parts of as many nodes each, cut across where they are longest; none is empty if n >= parts.
    """
    part = np.zeros(len(places), np.int32)
    todo: list[tuple[Array, int]] = [(np.arange(len(places)), parts)]
    made = 0
    while todo:
        nodes, count = todo.pop()
        if count == 1 or len(nodes) < 2:
            part[nodes] = made
            made += 1
            continue
        axis = np.argmax(np.ptp(places[nodes], axis=0))
        middle = len(nodes) * (count // 2) // count
        order = np.argpartition(places[nodes, axis], middle)
        todo += [(nodes[order[:middle]], count // 2), (nodes[order[middle:]], count - count // 2)]
    return part


def linear(places: Array, part: Array, free: Array) -> Array:
    """(n, 3, 4) orthonormal linear functions of place in every part, for each component.

    ``free`` (n, 3): where they are not zero. Those that the free nodes of a part do not tell from
    others are zero, as in a part that is flat.
    """
    modes = np.zeros((len(places), 3, 4), np.float32)
    order = np.argsort(part, kind="stable")
    for nodes in np.split(order, np.flatnonzero(np.diff(part[order])) + 1):
        for component in range(3):
            here = nodes[free[nodes, component]]
            if len(here) == 0:
                continue
            X = places[here] - places[here].mean(axis=0)
            size = np.abs(X).max(initial=0.0)
            X = np.column_stack([np.ones(len(here)), X / (size or 1.0)])
            U, sigma, _ = np.linalg.svd(X, full_matrices=False)
            kept = sigma > 1e-3 * sigma[0]
            modes[here, component, : kept.sum()] = U[:, kept]
    return modes


class Coarse:
    """Z, by `linear`, and A Z in single precision.

    Parameters
    ----------
    blocks : the matrix.
    pattern : (indptr, indices) of its AIJ blocks in this rank's columns.
    far : the same of the columns that other ranks own, numbered from 0; None on one rank.
    part : (rows + ghosts,) the part of each node, own ones first.
    parts : how many there are on all ranks.

    Vectors of the coarse space are (MODES parts,), those of nodes (3 rows,), single precision.
    """

    def __init__(
        self,
        blocks: Blocks,
        pattern: tuple[Array, Array],
        far: tuple[Array, Array] | None,
        part: Array,
        parts: int,
    ):
        self._blocks, self.part, self.parts = blocks, part, parts
        self.modes = np.zeros((len(part), 3, 4), np.float32)
        rows = blocks.rows
        keys = []
        for (indptr, indices), shift in ((pattern, 0), (far, rows)) if far else ((pattern, 0),):
            row = np.repeat(np.arange(rows), np.diff(indptr))
            keys.append(np.unique(row * parts + part[indices + shift]))
        row, near = np.divmod(np.unique(np.concatenate(keys)), parts)
        start = np.concatenate([[0], np.cumsum(np.bincount(row, minlength=rows))])
        image = np.zeros((len(near), 3, MODES), np.float32)
        ints = [part, pattern[1], start, near]
        part, column, start, near = (np.ascontiguousarray(a, np.int32) for a in ints)
        self._kept = [part, self.modes, column, start, near, image]
        self.nbytes = image.nbytes + start.nbytes + near.nbytes
        self.struct = blocks.ffi.new("Coarse *", [rows, *map(blocks.pointer, self._kept)])

    def coupled(self, values: int, far: int) -> Array:
        """(rows, 3) bool, the unknowns that an AIJ matrix with these values couples to others."""
        yes = np.zeros((self._blocks.rows, 3), np.uint8)
        addresses = self._blocks.addresses(values, far)
        self._blocks.lib.coupled(self._blocks.struct, *addresses, self._blocks.pointer(yes))
        return yes.astype(bool)

    def fill(self, values: int, far: int, scale: float, first: int, own: int) -> Array:
        """Take an AIJ matrix's values, at these addresses, times ``scale``.

        Returns this rank's rows of Z^T A Z: those of the ``own`` parts from ``first`` on.
        """
        E = np.zeros((MODES * own, MODES * self.parts))
        blocks, target = self._blocks, (first, self._blocks.pointer(E), E.shape[1])
        addresses = blocks.addresses(values, far)
        blocks.lib.coarse_fill(blocks.struct, self.struct, *addresses, scale, *target)
        return E
