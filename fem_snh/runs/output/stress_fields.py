r"""Stresses and strains of a problem's state at the quadrature points, and their means over cells.

With the displacement gradient H, F = I + H, J = det F and the first Piola-Kirchhoff stress P
(Bonet & Wood 2008, chapters 4 and 5):

.. math:: \sigma = \frac{1}{J} P F^T, \qquad E = \tfrac12 (H + H^T + H^T H) .

P is the stress of the element: with mean dilatation or a pressure unknown its pressure is the
element's pressure, not the derivative of the pointwise energy.
"""

from __future__ import annotations

from collections.abc import Collection
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np

from fem_snh.arrays import Array
from fem_snh.assembly.cell_loops import CellLoops, ElementTables, compile_cell_loops
from fem_snh.assembly.unknowns import local_values
from fem_snh.errors import on_root
from fem_snh.kernels import build
from fem_snh.kernels.build import cdata, header
from fem_snh.kernels.material import Compiled, Material
from fem_snh.problem.problem import Problem
from fem_snh.runs.output.point_fields import PointFieldLoops


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
        """Return the displacement gradient and the stress at a state. Not collective.

        Parameters
        ----------
        u : (components * nodes,)
            Displacement [m] of this rank's nodes, ghosts included.
        pressure : (pressure nodes,), optional
            The pressure unknown [Pa], likewise; None if the element has none.
        """
        shape = self._loops.num_cells, len(self._loops.tables.weights)
        weights = np.empty(shape)
        H, P = np.empty((3, 3, *shape)), np.empty((3, 3, *shape))
        arrays = [self._ffi.NULL if a is None else cdata(a) for a in (u, pressure, weights, H, P)]
        self._lib.stresses_cells(self._cells, *arrays)
        return PointStresses(weights, H.transpose(2, 3, 1, 0), P.transpose(2, 3, 1, 0))


#: Keys of the quadrature weights and the displacement gradient beside the fields, by name.
_WEIGHTS, _GRADIENT = "weights", "displacement_gradient"


class PointState(NamedTuple):
    """Strains and stresses at the quadrature points of this rank's cells.

    Attributes
    ----------
    weights : (cells, points)
        Quadrature weights in the reference configuration [m^3].
    H : (cells, points, 3, 3)
        Displacement gradients du_i/dX_j.
    values : dict of (cells, points, ...)
        The fields by name.
    """

    weights: Array
    H: Array
    values: dict[str, Array]

    def mean(self, name: str) -> Array:
        """Return the mean of a field over the reference volume of each cell, (cells, ...)."""
        values = self.values[name]
        if values.shape[1] == 1:
            return values[:, 0]
        weights = self.weights / self.weights.sum(axis=1, keepdims=True)
        return np.asarray(np.einsum("cq,cq...->c...", weights, values))


class StressFields:
    """Stresses and strains of a problem; compiles its kernels. Collective.

    Parameters
    ----------
    problem : Problem
        The problem.

    Attributes
    ----------
    loops : PointFieldLoops
        The loop over points that evaluates the fields.
    """

    def __init__(self, problem: Problem) -> None:
        self._problem = problem
        self._num_cells = problem.elastic.shape[0]
        self.loops = PointFieldLoops(problem.comm)
        self._parts = []
        for part in problem.elastic.parts:
            arguments = part.region.material, part.loops.tables
            compiled = on_root(problem.comm, compile_stress_loops, *arguments)
            self._parts.append((part.region.cells, StressLoops(compiled, part.loops)))

    def evaluate(self, x: PETSc.Vec, names: Collection[str]) -> PointState:
        """Return strains and stresses of this rank's cells at a state. Collective.

        In rigid cells all fields are zero.

        Parameters
        ----------
        x : PETSc.Vec
            The state.
        names : collection of str
            Names of ``POINT_FIELDS``.
        """
        u, p = self._problem.split(x)
        arrays = local_values(u), None if p is None else local_values(p)
        found = []
        for cells, loops in self._parts:
            weights, H, P = loops.evaluate(*arrays)
            values = self.loops.evaluate(H, P, names)
            found.append((cells, {_WEIGHTS: weights, _GRADIENT: H, **values}))
        merged, rigid = found[0][1], self._problem.rigid
        if len(found) > 1 or rigid:
            # Cells of rigid parts have no stress; any weight will do.
            merged = {k: np.zeros((self._num_cells, *a.shape[1:])) for k, a in merged.items()}
            if rigid:
                merged[_WEIGHTS][rigid.cells] = 1.0
            for cells, values in found:
                for name, part in values.items():
                    merged[name][cells] = part
        return PointState(merged.pop(_WEIGHTS), merged.pop(_GRADIENT), merged)
