"""Evaluate strains and stresses at the quadrature points of cells.

The loop is a library of its own, so that a run without stress fields does not compile it.
`fem_snh.runs.output.stress_fields` calls it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh.assembly.cell_loops import CellLoops, ElementTables, compile_cell_loops
from fem_snh.kernels import build
from fem_snh.kernels.compiled import Compiled
from fem_snh.kernels.headers import header
from fem_snh.kernels.material import Material

Array = npt.NDArray[np.float64]


class PointStresses(NamedTuple):
    """Displacement gradient and stress at the quadrature points of cells.

    Each component is contiguous in memory.

    Attributes
    ----------
    weights : (cells, points)
        Quadrature weights in the reference configuration [m^3]; they add up to the volume.
    H : (cells, points, 3, 3)
        Displacement gradients du_i/dX_j.
    P : (cells, points, 3, 3)
        First Piola-Kirchhoff stresses [Pa], with the element's own pressure.
    """

    weights: Array
    H: Array
    P: Array


def compile_stress_loops(material: Material, tables: ElementTables) -> Compiled:
    """Compile the loop for strains and stresses. Not collective."""
    return compile_cell_loops(material, tables, ("stress_api.h", "stress_loops.h"))


class StressLoops:
    """The compiled loop over cells for strains and stresses at quadrature points.

    Parameters
    ----------
    compiled : Compiled
        The library from `compile_stress_loops`.
    loops : CellLoops
        The loops over the same cells; they share element tables and constants.
    """

    def __init__(self, compiled: Compiled, loops: CellLoops) -> None:
        declarations = header("cell_api.h") + header("stress_api.h")
        self._ffi, self._lib = build.load(compiled.path, declarations)
        self._loops = loops
        self._cells = self._ffi.cast("Cells *", loops.cells_address)

    def evaluate(self, u: Array, pressure: Array | None = None) -> PointStresses:
        """Return strains and stresses at a state.

        Parameters
        ----------
        u : (3 nodes,)
            Displacement [m] of this rank's nodes, ghosts included.
        pressure : (pressure nodes,), optional
            The pressure unknown, for an element that has one.
        """
        shape = self._loops.num_cells, len(self._loops.tables.weights)
        weights = np.empty(shape)
        H, P = np.empty((3, 3, *shape)), np.empty((3, 3, *shape))
        arrays = [
            self._ffi.NULL if a is None else self._ffi.cast("double *", a.ctypes.data)
            for a in (u, pressure, weights, H, P)
        ]
        self._lib.stresses_cells(self._cells, *arrays)
        return PointStresses(weights, H.transpose(2, 3, 1, 0), P.transpose(2, 3, 1, 0))
