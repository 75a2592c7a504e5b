"""Assembly time of the filtered Jacobian, relative to PETSc's MatSetValuesCOO.

Both assemble the element matrices of the same compiled cell loops. Ours adds them directly to
the value arrays of the AIJ matrix; ``MatSetValuesCOO`` needs all of them in one array first.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from petsc4py import PETSc

import numpy as np

from benchmarks import Row, split_list
from benchmarks.assembly import CELLS, deformed, hessian, times
from fem_snh import _dolfinx, cache
from fem_snh.choices import FILTERS
from fem_snh.kernels.material import material as make_material
from fem_snh.terms.elastic import Elastic

# The petsc4py of PETSc 3.18 (Debian 12) lacks these functions. PetscCount is ptrdiff_t.
ffi = cache.c_declarations("""
int MatSetPreallocationCOO(void *A, ptrdiff_t n, int *rows, int *columns);
int MatSetValuesCOO(void *A, const double *values, int mode);
""")
_library = ffi.dlopen(PETSc.__file__)


def call(name: str, A: PETSc.Mat, *arguments: Any) -> None:
    """Call a PETSc function of a matrix; raise PETSc.Error if it fails."""
    if code := getattr(_library, name)(ffi.cast("void *", A.handle), *arguments):
        raise PETSc.Error(code)


def _ints(array: np.ndarray) -> Any:
    """Return a C pointer to an int32 array."""
    return ffi.cast("int *", array.ctypes.data)


class COOMatrix:
    """An AIJ matrix that is assembled from stored element matrices by ``MatSetValuesCOO``.

    Parameters
    ----------
    elastic : Elastic
        The elastic energy, on one rank and without constrained dofs.
    cell_nodes : (cells, n) int32
        Displacement nodes of each cell.
    num_nodes : int
        Nodes of the mesh.
    """

    def __init__(self, elastic: Elastic, cell_nodes: np.ndarray, num_nodes: int) -> None:
        self._loops = elastic.parts[0].loops
        cells, n = cell_nodes.shape
        dofs = (3 * cell_nodes[:, :, None] + np.arange(3)).reshape(cells, 3 * n)
        rows, columns = np.repeat(dofs, 3 * n, axis=1).ravel(), np.tile(dofs, (1, 3 * n)).ravel()
        self.mat = PETSc.Mat().create(comm=PETSc.COMM_SELF)
        self.mat.setSizes((3 * num_nodes, 3 * num_nodes))
        self.mat.setType(PETSc.Mat.Type.AIJ)
        i, j = (a.astype(PETSc.IntType) for a in (rows, columns))
        call("MatSetPreallocationCOO", self.mat, len(i), _ints(i), _ints(j))
        # One dense row-major matrix per cell: 3 n values in a row, whatever the node.
        first = np.arange(cells)[:, None, None] * (3 * n) ** 2
        a, b = np.arange(n)[:, None], np.arange(n)
        positions = (4 * (first + 9 * n * a + 3 * b)).astype(np.int32).ravel()
        strides = [np.full(num_nodes, 3 * n, np.int32) for _ in range(3)]
        self._arrays = (*strides, positions, np.ones((num_nodes, 3)), np.zeros(cells, np.uint8))
        self._target = self._loops.target(strides, *self._arrays[3:])
        self.values = np.zeros(cells * (3 * n) ** 2)
        self._target.values[0] = self._loops.pointer(self.values)

    def assemble(self, u: np.ndarray, filter: str) -> None:
        """Compute the element matrices at ``u`` (3 nodes,) and assemble them."""
        self.values[:] = 0.0
        self._loops.jacobian(u, FILTERS.index(filter), self._target)
        values = ffi.cast("double *", self.values.ctypes.data)
        call("MatSetValuesCOO", self.mat, values, int(PETSc.InsertMode.INSERT_VALUES))


def rows(
    elements: str = "Q1,P1,P2,Q2",
    cells: int = 0,
    material: str = "stable_neo_hookean",
    repeat: int = 7,
) -> Iterator[Row]:
    """Measure both assemblies on a deformed cube: one row per element, best of the repetitions.

    Parameters
    ----------
    cells : int
        Along the edge; default: those of the benchmark ``assembly``.
    material : str
        Name of the material.
    repeat : int
        Assemblies of each kind.
    """
    for name in split_list(elements):
        yield measure(name, cells or CELLS.get(name, 8), material, repeat)


def measure(name: str, cells: int, material: str, repeat: int) -> Row:
    """Return the seconds per call of both assemblies, and the largest difference of an entry."""
    domain, u = deformed(name, cells)
    V, in_place_hessian = u.function_space, hessian(u, name, make_material(material))
    matrix = in_place_hessian.matrix.mat
    coo = COOMatrix(in_place_hessian.elastic, _dolfinx.node_dofs(V), _dolfinx.num_nodes(V)[0])
    values = np.asarray(u.x.array)
    in_place_hessian.assemble("clamp")
    coo.assemble(values, "clamp")
    difference = coo.mat.copy()
    difference.axpy(-1.0, matrix, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
    taken = times(
        {
            "in_place": lambda: in_place_hessian.assemble("clamp"),
            "coo": lambda: coo.assemble(values, "clamp"),
        },
        repeat,
    )
    in_place, by_coo = taken["in_place"].min(), taken["coo"].min()
    infinity = PETSc.NormType.INFINITY
    return {
        "element": name,
        "material": material,
        "cells": domain.num_cells,
        "in_place_seconds": round(float(in_place), 6),
        "coo_seconds": round(float(by_coo), 6),
        "ratio": round(float(in_place / by_coo), 3),
        "coo_values_mb": round(coo.values.nbytes / 1e6, 1),
        "difference": float(f"{difference.norm(infinity) / matrix.norm(infinity):.1e}"),
    }
