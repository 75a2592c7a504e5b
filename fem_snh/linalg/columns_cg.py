r"""SSOR-preconditioned conjugate gradients for many right-hand sides, in double precision.

Each entry of the matrix is read once for eight columns, which is several times as fast as a solve
per column. With the diagonal scaled to one, :math:`A = L + I + L^T` on each rank's rows, and
conjugate gradients are written for :math:`(I + L)^{-1} A (I + L)^{-T}` as in
`fem_snh.linalg.ssor_system` (Eisenstat 1981).
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import AIJBlock, aij_blocks
from fem_snh.errors import on_root
from fem_snh.kernels import build
from fem_snh.linalg.halo import Halo

Array = npt.NDArray[Any]

#: Columns that are solved for together: doubles in a register of AVX-512, or a cache line.
LANES = 8
#: Bytes in a cache line, to which vectors are aligned.
_CACHE_LINE = 64
#: A bound: the mass matrix of trilinear hexahedra needs 20 iterations for 1e-13.
_MAX_ITERATIONS = 500


def source() -> str:
    """Return the C source, the same for every matrix."""
    sizes = f"#define LANES {LANES}"
    return "\n".join(["#include <string.h>", sizes, _text("api"), _text("kernels")])


def _text(part: str) -> str:
    return Path(__file__).with_name(f"columns_cg_{part}.h").read_text()


class ColumnsCG:
    """Solves A x = b for many columns b, with a symmetric positive definite matrix. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix with positive diagonal. It is scaled in place and must not be used afterwards.
    rtol : float
        Relative tolerance of each column's residual, in the norm sqrt(r.M^-1 r) of the SSOR
        preconditioner M.

    Attributes
    ----------
    iterations : int
        Iterations of the last block of columns.
    """

    def __init__(self, A: PETSc.Mat, rtol: float) -> None:
        self._comm, self._rtol, self.iterations = A.comm.tompi4py(), rtol, 0
        path = on_root(self._comm, build.library, source())
        self._ffi, self._lib = build.load(path, _text("api"))
        scale = A.getDiagonal()
        scale.sqrtabs()
        scale.reciprocal()
        A.diagonalScale(scale, scale)
        self._scale = np.array(scale.array_r)[:, None]
        with aij_blocks(A) as (diagonal, *off_diagonal):
            start, column, value = _rows(diagonal)
            arrays = {"start": start, "column": column, "value": value}
            ghosts: Array = np.empty(0, np.int32)
            if off_diagonal:
                names = "ghost_start", "ghost_column", "ghost_value"
                arrays |= dict(zip(names, _rows(off_diagonal[0]), strict=True))
                ghosts = off_diagonal[0].ghosts
        size = len(start) - 1
        entries = np.repeat(np.arange(size, dtype=np.int32), np.diff(start))
        arrays["diagonal"] = np.flatnonzero(column == entries).astype(np.int32)
        self._vectors = {name: _aligned(size) for name in "xrptw"}
        self._halo = None
        if off_diagonal:
            first = A.getOwnershipRanges()
            self._halo = Halo(self._comm, first, ghosts, LANES, np.float64)
            self._halo.ghosts = _aligned(len(ghosts))
            arrays["ghosts"] = self._halo.ghosts
        self._sums = {name: np.zeros(LANES) for name in ("rho", "previous", "curvature", "updated")}
        self._sum_pointers = [build.pointer(self._ffi, array) for array in self._sums.values()]
        self._arrays = arrays  # the struct holds pointers: the arrays must live as long
        pointers = {
            name: build.pointer(self._ffi, array)
            for name, array in (arrays | self._vectors).items()
        }
        self._struct = self._ffi.new("ColumnsCG *", {"rows": size, **pointers})

    def solve(self, b: Array) -> None:
        """Replace right-hand sides by solutions. Collective.

        A column that is not finite becomes NaN, and so does one that does not converge.

        Parameters
        ----------
        b : (blocks, rows, 8)
            This rank's rows of the columns, eight side by side.
        """
        for block in b:
            self._solve_block(block)

    def _solve_block(self, b: Array) -> None:
        """Replace eight right-hand sides by solutions: Saad 2003, alg. 9.1."""
        lib, vectors = self._lib, self._vectors
        rho, previous, curvature, updated = self._sums.values()
        at_rho, at_previous, at_curvature, at_updated = self._sum_pointers
        vectors["r"][:] = self._scale * b
        lib.columns_start(self._struct, at_rho)
        self._add_ranks(rho)
        previous[:] = 0
        limit = self._rtol**2 * rho
        for self.iterations in range(_MAX_ITERATIONS):
            if not (rho > limit).any():
                break
            lib.columns_backward(self._struct, at_rho, at_previous)
            if self._halo:
                self._halo.exchange(vectors["t"])
            lib.columns_forward(self._struct, at_curvature)
            self._add_ranks(curvature)
            lib.columns_update(self._struct, at_rho, at_curvature, at_updated)
            self._add_ranks(updated)
            previous[:], rho[:] = rho, updated
        b[:] = self._scale * vectors["x"]
        b[:, ~(rho <= limit)] = np.nan

    def _add_ranks(self, sums: Array) -> None:
        """Replace sums over this rank's rows by those over all rows."""
        if self._comm.size > 1:
            sums[:] = self._comm.allreduce(sums)


def _rows(block: AIJBlock) -> tuple[Array, Array, Array]:
    """Return copies of the row starts, columns and values of an AIJ block."""
    start, column = block.csr()
    return start.copy(), column.copy(), block.array().copy()


def _aligned(rows: int) -> Array:
    """Return zeros (rows, LANES) that start at a cache line."""
    size = rows * LANES
    memory = np.zeros(size + _CACHE_LINE // 8)
    first = -memory.ctypes.data % _CACHE_LINE // 8
    return memory[first : first + size].reshape(rows, LANES)
