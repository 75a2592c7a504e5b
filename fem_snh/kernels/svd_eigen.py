"""The rotation-variant SVD and the 3x3 eigensolvers of the kernels, for arrays of matrices."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.choices import EIGENSOLVERS
from fem_snh.errors import choose
from fem_snh.kernels import build, headers

Array = npt.NDArray[np.float64]


@lru_cache
def _svd_eigen_library() -> tuple[Any, Any]:
    """Return the compiled SVD and eigensolvers."""
    solvers = build.object_file(headers.svd_eigen_source())
    path = build.library(headers.svd_eigen_points_source(), [solvers])
    return build.load(path, headers.header("svd_eigen_api.h"))


def stored_by_columns(A: Array) -> Array:
    """Return matrices (..., 3, 3) stored by columns, (n, 9), as the C functions take them."""
    return np.ascontiguousarray(np.swapaxes(A, -1, -2)).reshape(-1, 9)


def svd(F: npt.ArrayLike) -> tuple[Array, Array, Array]:
    """Return the rotation-variant SVD F = U diag(sigma) V^T (Smith et al. 2018, eq. 2).

    Parameters
    ----------
    F : (..., 3, 3)
        Matrices.

    Returns
    -------
    U : (..., 3, 3)
        Rotations, det U = 1.
    sigma : (..., 3)
        Signed singular values, sigma_0 >= sigma_1 >= abs(sigma_2).
    V : (..., 3, 3)
        Rotations, det V = 1.
    """
    F = np.asarray(F, dtype=np.float64)
    columns = stored_by_columns(F)
    U, s, V = (np.empty((len(columns), size)) for size in (9, 3, 9))
    ffi, lib = _svd_eigen_library()
    lib.svd_points(len(columns), *(ffi.cast("double *", a.ctypes.data) for a in (columns, U, s, V)))
    rows = [np.swapaxes(a.reshape(F.shape), -1, -2) for a in (U, V)]
    return rows[0], s.reshape(F.shape[:-1]), rows[1]


def eigen3(A: npt.ArrayLike, eigensolver: str = EIGENSOLVERS[0]) -> tuple[Array, Array]:
    """Return eigenvalues and eigenvectors of symmetric 3x3 matrices.

    Parameters
    ----------
    A : (..., 3, 3)
        Symmetric matrices.
    eigensolver : str
        "cubic" or "jacobi".

    Returns
    -------
    values : (..., 3)
        Descending.
    vectors : (..., 3, 3)
        In columns.
    """
    A = np.asarray(A, dtype=np.float64)
    solver = EIGENSOLVERS.index(choose("eigensolver", eigensolver, EIGENSOLVERS))
    packed = np.ascontiguousarray(A.reshape(-1, 9)[:, [0, 4, 8, 1, 2, 5]])
    e, Q = (np.empty((len(packed), size)) for size in (3, 9))
    ffi, lib = _svd_eigen_library()
    a, b, c = (ffi.cast("double *", x.ctypes.data) for x in (packed, e, Q))
    lib.eigen3_points(len(packed), a, solver, b, c)
    return e.reshape(A.shape[:-1]), np.swapaxes(Q.reshape(A.shape), -1, -2)
