"""Flexible GMRES for several right-hand sides in one Krylov space (Saad 2003, alg. 9.6, sec. 6.12).

All vectors of a block are preconditioned together (`BlockTriangular.apply_to_columns`), and each
solution is the one of least residual in the span of all preconditioned vectors.
"""

from __future__ import annotations

from collections.abc import Sequence

from petsc4py import PETSc

import numpy as np

from fem_snh.solver.block_triangular import BlockTriangular
from fem_snh.solver.protocol import Array

#: Vectors of a block whose part outside of the space so far has less than this square, relative to
#: the largest, are left out: products are exact to single precision.
_DEPENDENT = 1e-9


def solve_columns(
    blocks: BlockTriangular, b: Sequence[PETSc.Vec], ksp: PETSc.KSP
) -> tuple[list[PETSc.Vec] | None, int]:
    """Return the solutions of A x = b for several b, and the number of iterations. Collective.

    None, if they do not converge: H may be indefinite.

    Parameters
    ----------
    blocks : BlockTriangular
        The preconditioner, set up.
    b : sequence of PETSc.Vec
        The right-hand sides.
    ksp : PETSc.KSP
        Its matrices, and its tolerances of the residual's norm: relative, and of iterations.
    """
    rtol, _, _, max_it = ksp.getTolerances()
    comm = b[0].comm.tompi4py()

    def products(left: Array, right: Array) -> Array:
        return np.asarray(comm.allreduce(left @ right.T))

    def extend(w: Array) -> None:
        """Add to the basis what rows are outside of it; append their coefficients to H."""
        coefficients = np.zeros((len(w), size))
        for _ in range(2):  # twice is enough (Parlett 1998, section 6.9)
            for start, v in basis:
                part = products(w, v)
                coefficients[:, start : start + len(v)] += part
                w = w - part @ v
        values, vectors = np.linalg.eigh(products(w, w))
        kept = values > _DEPENDENT * max(values[-1], 1e-300)
        new = (vectors[:, kept] / np.sqrt(values[kept])).T.astype(np.float32) @ w
        rows.append(np.hstack([coefficients, products(w, new)]))
        basis.append((size, new))

    norms = np.array([vector.norm() for vector in b])
    norms[norms == 0] = 1.0
    basis: list[tuple[int, Array]] = []  # orthonormal, with the number of vectors before them
    rows: list[Array] = []  # coefficients in them of b, then of the products with `preconditioned`
    preconditioned: list[Array] = []
    size = 0
    scaled = [vector.array_r / norm for vector, norm in zip(b, norms, strict=True)]
    extend(np.array(scaled, np.float32))
    for iterations in range(1, max_it + 1):
        size += len(basis[-1][1])
        z, w = blocks.apply_to_columns(basis[-1][1].astype(float))
        if blocks.indefinite:
            return None, iterations
        preconditioned.append(z.astype(np.float32))
        extend(w.astype(np.float32))
        H = _filled(rows)
        of_b, of_products = H[: len(b)], H[len(b) :]
        y = np.linalg.lstsq(of_products.T, of_b.T, rcond=None)[0].T
        if (np.linalg.norm(of_b - y @ of_products, axis=1) <= rtol).all():
            x = y.astype(np.float32) @ np.concatenate(preconditioned)
            solutions = zip(b, norms, x, strict=True)
            return [_vector(like, norm * own) for like, norm, own in solutions], iterations
        if not len(basis[-1][1]):
            break
    return None, iterations


def _filled(rows: list[Array]) -> Array:
    """Return rows of different lengths as a matrix."""
    width = rows[-1].shape[1]
    return np.concatenate([np.pad(row, ((0, 0), (0, width - row.shape[1]))) for row in rows])


def _vector(like: PETSc.Vec, values: Array) -> PETSc.Vec:
    vector = like.duplicate()
    vector.array[:] = values
    return vector
