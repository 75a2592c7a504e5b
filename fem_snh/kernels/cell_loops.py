"""The cell loops of one material on one element, as a compiled library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels import build
from fem_snh.kernels.codegen import source
from fem_snh.kernels.element_energy import ElementEnergy

DECLARATIONS = """
typedef struct {
  int cells; const int *nodes; const int *geometry; const double *x; const double *gradients;
  const double *geometry_gradients; const double *weights; const double *constants;
  const int *pressure_nodes; const double *pressure_basis;
} Cells;
typedef struct {
  double *values[3]; const int *stride[3]; const int *position;
  const double *free; const unsigned char *constrained;
} Target;
double energy_cells(const Cells *c, const double *u, const double *p);
void residual_cells(const Cells *c, const double *u, const double *p, double *r, double *r_p);
long jacobian_cells(const Cells *c, const double *u, const double *p, int filter, int solver,
                    const Target *t);
void fields_cells(const Cells *c, const double *u, const double *p, double *fields);
"""

FIELDS = ("volume", "deformed_volume", "min_J", "energy", "min_eigenvalue")

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class ElementTables:
    """What an element is on one rank's cells (shapes as in cell.h)."""

    nodes: Array  # (cells, NODES) int32
    geometry: Array  # (cells, GEOMETRY_NODES) int32
    x: Array  # (geometry nodes, 3)
    gradients: Array  # (POINTS, NODES, 3)
    geometry_gradients: Array  # (POINTS, GEOMETRY_NODES, 3)
    weights: Array  # (POINTS,)
    volume: str = "pointwise"  # as `fem_snh.fem.elements.Element` has it
    pressure_nodes: Array = field(default_factory=lambda: np.empty((0, 0), np.int32))
    pressure_basis: Array = field(default_factory=lambda: np.empty((0, 0)))  # (POINTS, .)

    @property
    def sizes(self) -> list[str]:
        """The element's sizes as C definitions."""
        points, nodes, _ = self.gradients.shape
        return [
            f"#define POINTS {points}",
            f"#define NODES {nodes}",
            f"#define GEOMETRY_NODES {self.geometry_gradients.shape[1]}",
            f"#define PRESSURE_NODES {self.pressure_basis.shape[1]}",
        ]


def cell_loops_source(law: ElementEnergy, tables: ElementTables) -> str:
    """The C source of ``law`` on an element with these tables."""
    after = ("cell.h", f"volume_{tables.volume}.h", "cell_loops.h")
    return source.kernel_source(law.energy, tables.sizes, after, law.functions)


class CellLoops:
    """Energy, residual, Jacobian and fields over one rank's cells; arrays are this rank's.

    ``pressure`` is that of an element that has one unknown, (nodes,), and otherwise None.
    """

    def __init__(self, path: Any, law: ElementEnergy, tables: ElementTables) -> None:
        self._ffi, self._lib = build.load(path, DECLARATIONS)
        t, floats, ints = tables, np.float64, np.int32
        arrays = [
            np.ascontiguousarray(array, dtype=kind)
            for array, kind in (
                (t.nodes, ints), (t.geometry, ints), (t.x, floats), (t.gradients, floats),
                (t.geometry_gradients, floats), (t.weights, floats), (law.energy.values, floats),
                (t.pressure_nodes, ints), (t.pressure_basis, floats),
            )
        ]  # fmt: skip
        self.num_cells = len(tables.nodes)
        # The struct holds pointers only: the arrays must live as long.
        self._kept = arrays
        self._cells = self._ffi.new("Cells *", [self.num_cells, *map(self.pointer, arrays)])

    def pointer(self, array: Array | None) -> Any:
        """A C pointer to the memory of ``array``, which the caller keeps alive."""
        if array is None:
            return self._ffi.NULL
        kind = {"float64": "double *", "int32": "int *", "uint8": "unsigned char *"}
        return self._ffi.cast(kind[array.dtype.name], array.ctypes.data)

    def target(self, strides: Sequence[Array], position: Array, free: Array, marked: Array) -> Any:
        """A Target for `jacobian`; its ``values`` are set by the caller before each use."""
        pointers = [self.pointer(a) for a in (*strides, position, free, marked)]
        target = self._ffi.new("Target *")
        target.stride = pointers[:3]
        target.position, target.free, target.constrained = pointers[3:]
        return target

    def address(self, number: int) -> Any:
        """A C pointer to doubles at this address."""
        return self._ffi.cast("double *", number)

    def energy(self, u: Array, pressure: Array | None = None) -> float:
        """The energy [J] of this rank's cells; +inf outside the domain."""
        return float(self._lib.energy_cells(self._cells, *map(self.pointer, (u, pressure))))

    def residual(
        self, u: Array, r: Array, pressure: Array | None = None, r_pressure: Array | None = None
    ) -> None:
        """Add the energy's derivatives to ``r`` and ``r_pressure``, ghost nodes included."""
        arrays = map(self.pointer, (u, pressure, r, r_pressure))
        self._lib.residual_cells(self._cells, *arrays)

    def jacobian(
        self, u: Array, filter: int, eigensolver: int, target: Any, pressure: Array | None = None
    ) -> int:
        """Add the filtered second derivative to ``target``; the points that had to be filtered."""
        arrays = map(self.pointer, (u, pressure))
        return int(self._lib.jacobian_cells(self._cells, *arrays, filter, eigensolver, target))

    def fields(self, u: Array, pressure: Array | None = None) -> dict[str, Array]:
        """Each of FIELDS per cell: volumes [m^3], min J, energy [J], smallest eigenvalue [Pa]."""
        out = np.empty((self.num_cells, len(FIELDS)))
        self._lib.fields_cells(self._cells, *map(self.pointer, (u, pressure, out)))
        return dict(zip(FIELDS, out.T, strict=True))
