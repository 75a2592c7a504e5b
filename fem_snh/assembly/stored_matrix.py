"""A matrix that is kept, and added to another of its layout while that one is assembled."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.linalg.blas import daxpy

from fem_snh._petsc import aij_blocks, values_at
from fem_snh.assembly.assembled_matrix import BlockMatrix

Array = npt.NDArray[Any]


class StoredMatrix:
    """A matrix of a problem's layout, with the rows and columns of constrained dofs. Collective.

    Parameters
    ----------
    matrix : BlockMatrix
        The problem's matrix.

    Attributes
    ----------
    mat : PETSc.Mat
        The matrix.
    """

    def __init__(self, matrix: BlockMatrix) -> None:
        self._blocks, self._layout = matrix.without_constraints(), matrix.layout
        self.mat = self._blocks.mat
        self._constrained: list[Array] | None = None

    def assemble(self, add: Callable[[BlockMatrix], Any]) -> None:
        """Assemble the matrix from what ``add`` adds to it. Collective."""
        with self._blocks.adding():
            add(self._blocks)

    def add_to(self, target: BlockMatrix, factor: float) -> None:
        """Add ``factor`` times the matrix, inside of `BlockMatrix.adding`. Collective.

        Rows and columns of constrained dofs are left out.
        """
        if target.layout is not self._layout:
            self._change_layout(target)
        sizes = self._layout.num_values
        if self._constrained is None:
            self._constrained = _entries(self.mat, target.constrained_dofs)
        with aij_blocks(self.mat) as blocks:
            for k, block in enumerate(blocks):
                values = values_at(target.addresses[k], sizes[k])
                if sizes[k]:
                    daxpy(block.array(), values, a=factor)
                values[self._constrained[k]] = 0.0

    def _change_layout(self, matrix: BlockMatrix) -> None:
        """Take the layout of a matrix whose pattern has changed, and keep the values.

        The former pattern may have pairs of nodes that the new one lacks. They share no cell, so
        their values here are zero.
        """
        blocks = matrix.without_constraints()
        blocks.mat.setOption(PETSc.Mat.Option.IGNORE_ZERO_ENTRIES, True)
        blocks.mat.axpy(1.0, self.mat, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
        self._blocks, self._layout, self.mat = blocks, matrix.layout, blocks.mat
        self._constrained = None


def _entries(A: PETSc.Mat, dofs: Array) -> list[Array]:
    """Return the offsets of the values in rows and columns of some dofs. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        A matrix of the layout.
    dofs : (n,) int
        Dofs that this rank owns, as indices into a vector's local array.

    Returns
    -------
    list of (m,) int
        Offsets into the values of the diagonal block and, on several ranks, of the off-diagonal
        one.
    """
    ones, others = A.duplicate(), A.createVecLeft()
    others.set(1.0)
    others.array[dofs] = 0.0
    with aij_blocks(ones) as blocks:
        for block in blocks:
            block.array()[:] = 1.0
    ones.diagonalScale(others, others)
    with aij_blocks(ones) as blocks:
        return [np.flatnonzero(block.array() == 0) for block in blocks]
