"""The cell loops of one material on one element, as a compiled library."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.kernels import build, codegen
from fem_snh.materials.energy import Energy

DECLARATIONS = """
typedef struct {
  int cells; const int *nodes; const int *geometry; const double *x; const double *gradients;
  const double *geometry_gradients; const double *weights; const double *constants;
} Cells;
typedef struct {
  double *values[3]; const int *stride[3]; const int *position;
  const double *free; const unsigned char *constrained;
} Target;
double energy_cells(const Cells *c, const double *u);
void residual_cells(const Cells *c, const double *u, double *r);
long jacobian_cells(const Cells *c, const double *u, int filter, int solver, const Target *t);
void fields_cells(const Cells *c, const double *u, double *fields);
"""

FIELDS = ("volume", "deformed_volume", "min_J", "energy", "min_eigenvalue")

Array = npt.NDArray[Any]


@dataclass(frozen=True)
class Tables:
    """What an element is on one rank's cells (shapes as in cell.h)."""

    nodes: Array  # (cells, NODES) int32
    geometry: Array  # (cells, GEOMETRY_NODES) int32
    x: Array  # (geometry nodes, 3)
    gradients: Array  # (POINTS, NODES, 3)
    geometry_gradients: Array  # (POINTS, GEOMETRY_NODES, 3)
    weights: Array  # (POINTS,)

    @property
    def sizes(self) -> list[str]:
        """The element's sizes as C definitions."""
        points, nodes, _ = self.gradients.shape
        return [
            f"#define POINTS {points}",
            f"#define NODES {nodes}",
            f"#define GEOMETRY_NODES {self.geometry_gradients.shape[1]}",
        ]


def c_source(law: Energy, tables: Tables) -> str:
    """The C source of ``law`` on an element with these sizes."""
    return codegen.source(law, before=tables.sizes, after=("cell.h",))


class CellLoops:
    """Energy, residual, Jacobian and fields over one rank's cells; arrays are this rank's."""

    def __init__(self, path: Any, law: Energy, tables: Tables) -> None:
        self._ffi, self._lib = build.load(path, DECLARATIONS)
        constants = np.array(law.values, dtype=np.float64)
        kinds = [np.int32, np.int32, *[np.float64] * 4]
        arrays = [
            np.ascontiguousarray(a, dtype=k)
            for a, k in zip(vars(tables).values(), kinds, strict=True)
        ]
        self.num_cells = len(tables.nodes)
        # The struct holds pointers only: the arrays must live as long.
        self._kept = [*arrays, constants]
        self._cells = self._ffi.new("Cells *", [self.num_cells, *map(self.pointer, self._kept)])

    def pointer(self, array: Array) -> Any:
        """A C pointer to the memory of ``array``, which the caller keeps alive."""
        kind = {"float64": "double *", "int32": "int *", "uint8": "unsigned char *"}
        return self._ffi.cast(kind[array.dtype.name], array.ctypes.data)

    def target(self, strides: list[Array], position: Array, free: Array, marked: Array) -> Any:
        """A Target for `jacobian`; its ``values`` are set by the caller before each use."""
        pointers = [self.pointer(a) for a in (*strides, position, free, marked)]
        target = self._ffi.new("Target *")
        target.stride = pointers[:3]
        target.position, target.free, target.constrained = pointers[3:]
        return target

    def address(self, number: int) -> Any:
        """A C pointer to doubles at this address."""
        return self._ffi.cast("double *", number)

    def energy(self, u: Array) -> float:
        """The integral of psi [J] over this rank's cells; +inf outside the domain."""
        return float(self._lib.energy_cells(self._cells, self.pointer(u)))

    def residual(self, u: Array, r: Array) -> None:
        """Add dE/du [N] to ``r``, ghost nodes included."""
        self._lib.residual_cells(self._cells, self.pointer(u), self.pointer(r))

    def jacobian(self, u: Array, filter: int, eigensolver: int, target: Any) -> int:
        """Add the filtered d2E/du2 to ``target``; the number of points that had to be filtered."""
        call = self._lib.jacobian_cells
        return int(call(self._cells, self.pointer(u), filter, eigensolver, target))

    def fields(self, u: Array) -> dict[str, Array]:
        """Each of FIELDS per cell: volumes [m^3], min J, energy [J], smallest eigenvalue [Pa]."""
        out = np.empty((self.num_cells, len(FIELDS)))
        self._lib.fields_cells(self._cells, self.pointer(u), self.pointer(out))
        return dict(zip(FIELDS, out.T, strict=True))
