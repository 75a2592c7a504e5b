r"""Sparse factors :math:`L D L^T` of a symmetric matrix, their inertia and a negative eigenvector.

By Sylvester's law of inertia :math:`D` has as many negative eigenvalues as the matrix (Golub & Van
Loan 2013, section 8.1.5). MUMPS counts them while it factorises.
"""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import (
    expect_singular_matrix,
    factors_out_of_memory,
    negative_pivots,
    set_operators,
)
from fem_snh.errors import Failed
from fem_snh.linalg.direct_solver import set_direct_solver

#: Lanczos iterations: so many, and twice the number of negative eigenvalues up to a limit. Those of
#: largest magnitude of the inverse converge first (Saad 2011, section 6.6).
_LANCZOS, _MOST_SOUGHT = 20, 20
#: Error of a Ritz value, relative to it, below which its vector is used.
_CONVERGED = 0.1


class SymmetricFactors:
    """The factors of a symmetric matrix. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix; its constrained rows have a positive diagonal entry alone.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        self._A, self._ksp = A, PETSc.KSP().create(A.comm)
        set_direct_solver(self._ksp)
        expect_singular_matrix(self._ksp)

    def factorise(self) -> int:
        """Factorise the matrix's present values; return its number of negative eigenvalues.

        Raises
        ------
        Failed
            If the factors do not fit into memory.
        """
        set_operators(self._ksp, self._A, self._A)
        pc = self._ksp.getPC()
        self._ksp.setUp()
        if factors_out_of_memory(pc):
            raise Failed("out of memory (the factors of the Hessian)")
        found = negative_pivots(pc)
        assert found is not None
        return found

    @property
    def null_pivots(self) -> int:
        """Return how many pivots of the last factors are zero, as those of rows of zeros."""
        return int(self._ksp.getPC().getFactorMatrix().getMumpsInfog(28))

    def negative_direction(self, negative: int, start: PETSc.Vec) -> PETSc.Vec | None:
        """Return the eigenvector of the lowest eigenvalue that is found, of norm 1. Collective.

        The Lanczos method on the inverse finds the eigenvalues next to zero on either side.

        Parameters
        ----------
        negative : int
            The result of `factorise`.
        start : Vec
            The start vector, which is overwritten; the eigenvector makes an acute angle with it.

        Returns
        -------
        Vec or None
            A direction of negative curvature; None if none is found.
        """
        comm, w, v = self._A.comm.tompi4py(), start.duplicate(), start.copy()
        v.normalize()
        count = min(_LANCZOS + 2 * min(negative, _MOST_SOUGHT), start.getSize())
        basis, T = np.zeros((count, len(start.array_r))), np.zeros((count, count))
        for k in range(count):
            basis[k] = v.array_r
            self._ksp.solve(v, w)
            T[k, k] = w.dot(v)
            for _ in range(2):  # twice is enough (Parlett 1998, section 6.9)
                w.array -= comm.allreduce(basis[: k + 1] @ w.array_r) @ basis[: k + 1]
            remainder = w.norm()
            if remainder <= abs(T[0, 0]) * np.finfo(float).eps:
                count = k + 1
                break
            if k + 1 < count:
                T[k, k + 1] = T[k + 1, k] = remainder
            w.scale(1 / remainder)
            w, v = v, w
        ritz, vectors = np.linalg.eigh(T[:count, :count])
        errors = remainder * np.abs(vectors[-1])
        best, lowest = None, 0.0
        for value, error, vector in zip(ritz, errors, vectors.T, strict=True):
            if value >= 0 or (best is not None and error > _CONVERGED * abs(value)):
                continue
            v.array = np.copysign(1.0, vector[0]) * vector @ basis[:count]
            self._A.mult(v, w)
            if (curvature := float(w.dot(v))) < lowest:
                best, lowest = v.copy(), curvature
        return best

    def removed_by(self, operator: PETSc.Mat) -> int:
        r"""Return how many negative eigenvalues the operator has less than the matrix. Collective.

        The operator is a MATLRC, :math:`A + U C U^T` with a diagonal :math:`C \ge 0`. As inertia is
        additive in :math:`[A, U; U^T, -C^{-1}]`, they are as many as the eigenvalues of
        :math:`C^{-1} + U^T A^{-1} U` that are not positive (Haynsworth 1968).
        """
        _, U, c, _ = operator.getLRCMats()
        comm, scales = self._A.comm.tompi4py(), np.array(c.array_r)
        columns = np.array(U.getDenseArray())[:, scales > 0]
        x, solved = self._A.createVecRight(), np.empty_like(columns)
        y = x.duplicate()
        for k, column in enumerate(columns.T):
            x.array = column
            self._ksp.solve(x, y)
            solved[:, k] = y.array_r
        S = np.diag(1 / scales[scales > 0]) + comm.allreduce(columns.T @ solved)
        return int((np.linalg.eigvalsh((S + S.T) / 2) <= 0).sum())

    def destroy(self) -> None:
        """Destroy the factors. Collective."""
        self._ksp.destroy()
