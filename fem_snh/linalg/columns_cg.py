r"""SSOR-preconditioned conjugate gradients for several right-hand sides at once.

An iteration is memory traffic. With `LANES` columns side by side each entry of the matrix is read
once for all of them, and eight columns take little longer than one.

`SSORColumns` are the conjugate gradients of `fem_snh.linalg.ssor_cg`. `ColumnsCG` are for any
positive definite matrix, in double precision. With its diagonal scaled to one,
:math:`A = L + I + L^T` on each rank's rows, and conjugate gradients are written for
:math:`(I + L)^{-1} A (I + L)^{-T}` as in `fem_snh.linalg.ssor_system` (Eisenstat 1981).
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt

from fem_snh._petsc import AIJBlock, aij_blocks
from fem_snh.kernels import build
from fem_snh.linalg.block_matrix import open_kernels
from fem_snh.linalg.deflation import Projection
from fem_snh.linalg.halo import Halo
from fem_snh.linalg.ssor_system import ZERO_CURVATURE, Solutions, SSORSystem

Array = npt.NDArray[Any]

#: Columns that are solved for together: doubles in a register of AVX-512 or a cache line, floats in
#: a register of AVX.
LANES = 8
#: Bytes in a cache line, to which vectors are aligned.
_CACHE_LINE = 64
#: A bound: the mass matrix of trilinear hexahedra needs 20 iterations for 1e-13.
_MAX_ITERATIONS = 500


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
        self._ffi, self._lib = build.open_library(
            ["columns_cg_api.h"],
            ["columns_cg_kernels.h"],
            [f"#define LANES {LANES}"],
            comm=self._comm,
        )
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


def _positive(curvature: Array) -> bool:
    return bool(((curvature > 0) & np.isfinite(curvature)).all())


class SSORColumns:
    """Solves A x = b for several b, with the copy of the matrix of an `SSORSystem`. Collective.

    Parameters
    ----------
    system : SSORSystem
        The matrix, its preconditioner and its deflation space; their present values are used.
    """

    def __init__(self, system: SSORSystem) -> None:
        self._system, self._comm = system, system.comm
        matrix = system.matrix
        self._size = matrix.size * matrix.rows
        self._ffi, self._lib = open_kernels(
            self._comm,
            matrix.size,
            ["ssor_columns_api.h"],
            ["ssor_columns_kernels.h"],
            [f"#define LANES {LANES}"],
        )
        self._matrix = self._struct("SymmetricBlockMatrix *", matrix.struct)
        self._projection: Projection | None = None
        if deflation := system.deflation:
            struct = self._struct("CoarseSpace *", deflation.struct)
            libraries = self._ffi, self._lib
            self._projection = Projection(deflation.E, deflation.size, *libraries, struct, LANES)
        names = "xrzptwq"
        self._vectors: dict[str, npt.NDArray[np.float32]] = {
            key: np.zeros((self._size, LANES), np.float32) for key in names
        }
        self._halo = None
        if layout := system.halo:
            self._halo = Halo(self._comm, layout.first, layout.nodes, matrix.size * LANES)
            self._vectors["ghosts"] = self._halo.ghosts
        else:
            self._vectors["ghosts"] = self._vectors["x"]
        self._at = {key: build.pointer(self._ffi, v) for key, v in self._vectors.items()}

    def solve(self, b: Array, rtol: float, max_it: int) -> Solutions:
        """Return the solutions to a relative tolerance in the norm sqrt(r.M^-1 r), or nearly so.

        Parameters
        ----------
        b : (columns, size rows)
            This rank's rows of the right-hand sides.
        rtol : float
            The tolerance.
        max_it : int
            Iterations after which what was found is returned.
        """
        x, residual, indefinite = np.empty_like(b), np.empty_like(b), False
        for first in range(0, len(b), LANES):
            some = slice(first, first + LANES)
            x[some], residual[some], failed = self._solve_lanes(b[some], rtol, max_it)
            indefinite |= failed
        return Solutions(x, residual, indefinite)

    def _solve_lanes(self, b: Array, rtol: float, max_it: int) -> Solutions:
        """Return the solutions for up to `LANES` right-hand sides (Saad 2003, alg. 9.1)."""
        lib, matrix, at, vectors = self._lib, self._matrix, self._at, self._vectors
        count = len(b)
        size = np.abs(b).max(axis=1, initial=0.0)
        self._comm.Allreduce(MPI.IN_PLACE, size, MPI.MAX)
        size[~(np.isfinite(size) & (size > 0))] = 1.0
        for vector in "xrptwq":
            vectors[vector][:] = 0
        vectors["r"][:, :count] = (b / size[:, None]).T
        vectors["z"][:] = vectors["r"]
        if self._projection:
            self._projection.start(at["r"], count)
        lib.columns_solve_lower(matrix, at["z"])
        lib.columns_solve_lower(matrix, at["r"])
        sums: Array = np.zeros(LANES)
        beta, alpha = np.zeros(LANES, np.float32), np.zeros(LANES, np.float32)
        at_sums, at_alpha, at_beta = (
            build.pointer(self._ffi, array) for array in (sums, alpha, beta)
        )

        def update(names: str = "tqxrz") -> Array:
            lib.columns_update(matrix, at_alpha, *(at[key] for key in names), at_sums)
            return self._sum(sums)

        whole = update("tqxzw")  # the tolerance is relative to the norm of b, not to that of P b
        rho, limit = update(), rtol**2 * whole
        # Sweeps over a positive definite matrix are bounded; an overflow shows an indefinite one.
        indefinite = not np.isfinite([whole, rho]).all()
        active = rho > limit
        for _ in range(max_it):
            if indefinite or not active.any():
                break
            lib.columns_backward_sweep(matrix, at_beta, *(at[key] for key in "zptw"))
            if self._halo:
                self._halo.exchange(vectors["t"])
            if self._projection:
                self._projection.project(at["t"], at["w"], count)
            names = (at[key] for key in ("p", "t", "ghosts", "w", "q"))
            lib.columns_forward_sweep(matrix, *names, at_sums)
            curvature = self._sum(sums)
            if not _positive(curvature[active]):
                active &= ~self._in_null_space(curvature)
                if indefinite := not _positive(curvature[active]):
                    break
            alpha[:] = np.divide(rho, curvature, out=np.zeros(LANES), where=active)
            new = update()
            indefinite = not np.isfinite(new).all()
            beta[:] = np.divide(new, rho, out=np.zeros(LANES), where=active)
            rho = new
            active &= rho > limit
        residual = np.zeros_like(vectors["r"])
        lib.columns_multiply_lower(matrix, at["r"], build.pointer(self._ffi, residual))
        if self._projection:
            self._projection.finish(at["x"], count)
        scales = size * self._system.scale
        x = np.multiply(vectors["x"][:, :count].T, scales[:, None], dtype=float)
        r = np.multiply(residual[:, :count].T, size[:, None], dtype=float)
        return Solutions(x, r, indefinite)

    def _in_null_space(self, curvature: Array) -> Array:
        """Return whether each column's direction has a curvature of zero, to rounding."""
        norms = [self._system.matrix.weighted_norm_squared(p) for p in self._vectors["p"].T]
        return (curvature <= 0) & (curvature >= -ZERO_CURVATURE * self._sum(np.array(norms)))

    def _struct(self, kind: str, struct: Any) -> Any:
        """Return another library's struct for this one's functions."""
        return self._ffi.cast(kind, int(self._system.matrix.ffi.cast("uintptr_t", struct)))

    def _sum(self, own: Array) -> Array:
        """Return the sums over all ranks."""
        total = own.copy()
        if self._comm.size > 1:
            self._comm.Allreduce(MPI.IN_PLACE, total)
        return total
