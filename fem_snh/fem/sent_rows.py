"""The rows of a matrix to which a rank contributes without owning them."""

from __future__ import annotations

from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import call, ffi
from fem_snh.fem.matrix_layout import MatrixLayout
from fem_snh.fem.numbering import MixedDofMap
from fem_snh.kernels.block_pattern import concatenated_ranges

Array = npt.NDArray[Any]


class SentRows:
    """Values of the rows of ghost blocks, which are sent to their owners.

    Parameters
    ----------
    dof_map : MixedDofMap
        The numbering of the unknowns.
    layout : MatrixLayout
        The pattern of these rows.

    Attributes
    ----------
    values : (n,) float64
        The values, row by row.
    """

    def __init__(self, dof_map: MixedDofMap, layout: MatrixLayout) -> None:
        sent = layout.sent
        self._row_offsets = sent.row_offsets
        self.values = np.zeros(int(sent.row_offsets[-1]))
        dofs, self._sizes = dof_map.global_dofs(layout.ghosts)
        self._rows = concatenated_ranges(dofs, self._sizes).astype(PETSc.IntType)
        blocks = dof_map.local_to_global[sent.indices]
        columns = concatenated_ranges(*dof_map.global_dofs(blocks))
        self._columns, self._lengths = columns.astype(PETSc.IntType), sent.row_lengths

    def add_to(self, mat: PETSc.Mat) -> None:
        """Pass the rows to PETSc, which sends them when it assembles."""
        handle = ffi.cast("void *", mat.handle)
        values = ffi.cast("double *", self.values.ctypes.data)
        row, column = (ffi.cast("int *", a.ctypes.data) for a in (self._rows, self._columns))
        add = int(PETSc.InsertMode.ADD)
        row_start = np.cumsum(self._sizes) - self._sizes
        column_start = np.cumsum(self._lengths) - self._lengths
        sizes, lengths = self._sizes.tolist(), self._lengths.tolist()
        for i, (size, length) in enumerate(zip(sizes, lengths, strict=True)):
            if length:
                block = (size, row + int(row_start[i]), length, column + int(column_start[i]))
                offset = int(self._row_offsets[i])
                call("MatSetValues", handle, *block, values + offset, add)
