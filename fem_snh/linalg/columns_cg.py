"""Conjugate gradients of `fem_snh.linalg.ssor_cg` for several right-hand sides at once.

An iteration is memory traffic. With `LANES` columns side by side each entry of the matrix is read
once for all of them, and eight columns take little longer than one.
"""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import numpy.typing as npt

from fem_snh.kernels import build
from fem_snh.linalg.block_matrix import open_kernels
from fem_snh.linalg.deflation import Projection
from fem_snh.linalg.halo import Halo
from fem_snh.linalg.ssor_system import ZERO_CURVATURE, Solutions, SSORSystem

Array = npt.NDArray[Any]

#: Columns that are solved for together: doubles in a register of AVX-512 or a cache line, floats in
#: a register of AVX.
LANES = 8


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
