r"""Sparse direct solvers: MUMPS, for any nu and any inertia; PETSc's own for small matrices.

Studies and benchmarks use MUMPS for reference solutions. A matrix that is not symmetric has factors
L U.

The factors of a symmetric matrix are :math:`L D L^T`. By Sylvester's law of inertia :math:`D` has
as many negative eigenvalues as the matrix (Golub & Van Loan 2013, section 8.1.5). MUMPS counts them
while it factorises.

With the factors of A the Sherman-Morrison-Woodbury formula

.. math::

    (A + U C U^T)^{-1} = A^{-1} - Z (C^{-1} + U^T Z)^{-1} Z^T, \quad Z = A^{-1} U,

inverts the sum (Golub & Van Loan 2013, section 2.1.4). The inverse of A alone is an indefinite
preconditioner where only the sum is definite: a body inflated beyond its largest pressure is stable
by the volume of the fluid, and A is its Hessian at constant pressure. Far from an equilibrium,
where the pressure is large, Newton's method needs fewer iterations with the inverse of A alone: it
finds the Hessian indefinite, and filters it.
"""

from __future__ import annotations

from math import nan

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import (
    as_aij,
    expect_definite_matrix,
    expect_singular_matrix,
    factors_out_of_memory,
    is_cholesky,
    negative_pivots,
    set_operators,
)
from fem_snh.errors import Failed

#: The PETSc options. MUMPS' "cholesky" is LDL^T, for symmetric indefinite matrices too.
DIRECT_SOLVER = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}
#: Unknowns of a matrix in two dimensions up to which PETSc's factors cost less than those by MUMPS
#: (python -m benchmarks small_factors; docs/results/linear_solver.md).
MAX_SMALL = 2000
#: Difference of x . A y and y . A x, relative to |x| |A y|, below which A counts as symmetric:
#: rounding leaves 1e-14.
_ROUNDING = 1e-11


def set_direct_solver(ksp: PETSc.KSP, small: bool = False) -> None:
    """Configure an existing KSP as `DIRECT_SOLVER`.

    With ``small``, on one rank, PETSc factorises until a matrix is not positive definite.
    """
    ksp.setType(DIRECT_SOLVER["ksp_type"])
    set_direct_factors(ksp.getPC())
    if small:
        expect_definite_matrix(ksp)


def set_direct_factors(pc: PETSc.PC) -> None:
    """Configure an existing PC as `DIRECT_SOLVER`."""
    pc.setType(DIRECT_SOLVER["pc_type"])
    pc.setFactorSolverType(DIRECT_SOLVER["pc_factor_mat_solver_type"])


def is_direct(ksp: PETSc.KSP) -> bool:
    """Return whether a KSP is configured as by `set_direct_solver`."""
    packages = PETSc.Mat.SolverType.PETSC, PETSc.Mat.SolverType.MUMPS
    preonly = ksp.getType() == DIRECT_SOLVER["ksp_type"]
    return preonly and any(is_cholesky(ksp.getPC(), package) for package in packages)


def is_symmetric(A: PETSc.Mat) -> bool:
    """Return whether a square matrix is symmetric but for rounding. Collective.

    The test compares x . A y and y . A x for two vectors without symmetry.
    """
    x, y = A.createVecs()
    first, last = x.getOwnershipRange()
    x.array[:], y.array[:] = np.sin(np.arange(first, last)), np.cos(1.7 * np.arange(first, last))
    Ax, Ay = x.duplicate(), x.duplicate()
    A.mult(x, Ax)
    A.mult(y, Ay)
    return bool(abs(x.dot(Ay) - y.dot(Ax)) <= _ROUNDING * x.norm() * Ay.norm())


def set_asymmetric_factors(ksp: PETSc.KSP) -> None:
    """Configure an existing KSP as a direct solver with factors L U by MUMPS."""
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.LU)
    ksp.getPC().setFactorSolverType(DIRECT_SOLVER["pc_factor_mat_solver_type"])


#: Lanczos iterations: this number plus twice the number of negative eigenvalues, up to a limit. The
#: inverse's eigenvalues of largest magnitude converge first (Saad 2011, section 6.6).
_LANCZOS, _MOST_SOUGHT = 20, 20
#: Relative error of a Ritz value below which its Ritz vector is used.
_CONVERGED = 0.1


class SymmetricFactors:
    """The factors of a symmetric matrix. Collective.

    Parameters
    ----------
    A : PETSc.Mat
        An AIJ matrix or a half; its constrained rows have only a positive diagonal entry.
    """

    def __init__(self, A: PETSc.Mat) -> None:
        self._A, self._ksp = as_aij(A), PETSc.KSP().create(A.comm)
        set_direct_solver(self._ksp)
        expect_singular_matrix(self._ksp)

    def factorise(self) -> int:
        """Factorise the matrix's present values; return its number of negative eigenvalues.

        Raises
        ------
        Failed
            If the factors do not fit into memory.
        """
        _factorise(self._ksp, self._A)
        found = negative_pivots(self._ksp.getPC())
        assert found is not None
        return found

    @property
    def null_pivots(self) -> int:
        """Return how many pivots of the last factors are zero, such as those of zero rows."""
        return int(self._ksp.getPC().getFactorMatrix().getMumpsInfog(28))

    def negative_direction(self, negative: int, start: PETSc.Vec) -> PETSc.Vec | None:
        """Return an approximate eigenvector of a negative eigenvalue, of norm 1. Collective.

        The Lanczos method on the inverse finds the eigenvalues next to zero on either side; the
        lowest one is chosen. `factorise` must have been called.

        Parameters
        ----------
        negative : int
            The result of `factorise`.
        start : Vec
            The start vector, with which the result makes an acute angle.

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
        r"""Return how many fewer negative eigenvalues the operator has than the matrix. Collective.

        The operator is a MATLRC, :math:`A + U C U^T` with a diagonal :math:`C \ge 0`. As inertia is
        additive in :math:`[A, U; U^T, -C^{-1}]`, this is the number of eigenvalues of
        :math:`C^{-1} + U^T A^{-1} U` that are not positive (Haynsworth 1968).
        """
        _, S = solve_columns(self._ksp, operator)
        return int((np.linalg.eigvalsh(S) <= 0).sum())

    def close(self) -> None:
        """Destroy the factors. Collective."""
        self._ksp.destroy()


def _factorise(ksp: PETSc.KSP, A: PETSc.Mat) -> None:
    """Compute the factors of A; raise Failed if they do not fit into memory."""
    set_operators(ksp, A, A)
    ksp.setUp()
    if factors_out_of_memory(ksp.getPC()):
        raise Failed("out of memory (the factors of the Hessian)")


class FactorsOfSum:
    """A PC of type "python": the inverse of an operator :math:`A + U C U^T`, a MATLRC."""

    def __init__(self) -> None:
        self._ksp: PETSc.KSP | None = None

    def setUp(self, pc: PETSc.PC) -> None:
        """Factorise the present values of A, the matrix of the PC; PETSc calls this.

        Raises
        ------
        Failed
            If the factors do not fit into memory.
        """
        operator, A = pc.getOperators()
        if self._ksp is None:
            self._ksp = PETSc.KSP().create(A.comm)
            set_direct_solver(self._ksp)
        _factorise(self._ksp, A)
        self._Z, S = solve_columns(self._ksp, operator)
        try:
            self._S_inverse = np.linalg.inv(S)
        except np.linalg.LinAlgError:  # the sum is singular
            self._S_inverse = np.full_like(S, nan)

    def apply(self, pc: PETSc.PC, x: PETSc.Vec, y: PETSc.Vec) -> None:
        """Compute y, the inverse times x, or NaN if the sum is singular; PETSc calls this."""
        assert self._ksp is not None
        self._ksp.solve(x, y)
        part = x.comm.tompi4py().allreduce(self._Z.T @ x.array_r)
        y.array[:] -= self._Z @ (self._S_inverse @ part)

    def destroy(self, pc: PETSc.PC) -> None:
        """Destroy the factors; PETSc calls this."""
        if self._ksp is not None:
            self._ksp.destroy()


def set_direct_solver_of_sum(ksp: PETSc.KSP) -> None:
    """Configure an existing KSP to apply `FactorsOfSum`; its operator must be a MATLRC."""
    ksp.setType(PETSc.KSP.Type.PREONLY)
    ksp.getPC().setType(PETSc.PC.Type.PYTHON)
    ksp.getPC().setPythonContext(FactorsOfSum())


def is_factors_of_sum(pc: PETSc.PC) -> bool:
    """Return whether a PC is `FactorsOfSum`."""
    is_python = pc.getType() == PETSc.PC.Type.PYTHON
    return is_python and isinstance(pc.getPythonContext(), FactorsOfSum)


def solve_columns(ksp: PETSc.KSP, operator: PETSc.Mat) -> tuple[np.ndarray, np.ndarray]:
    r"""Return :math:`Z = A^{-1} U` and :math:`S = C^{-1} + U^T Z` of an operator. Collective.

    Parameters
    ----------
    ksp : KSP
        Solves with A.
    operator : Mat
        A MATLRC, :math:`A + U C U^T` with a diagonal :math:`C \ge 0`; columns of U with a zero in C
        are left out.

    Returns
    -------
    (rows, columns), (columns, columns)
        Z has this rank's rows; S is symmetric.
    """
    A, U, c, _ = operator.getLRCMats()
    scales = np.array(c.array_r)
    columns = np.array(U.getDenseArray())[:, scales > 0]
    x, y = A.createVecs()
    Z = np.empty_like(columns)
    for k, column in enumerate(columns.T):
        x.array = column
        ksp.solve(x, y)
        Z[:, k] = y.array_r
    S = np.diag(1 / scales[scales > 0]) + A.comm.tompi4py().allreduce(columns.T @ Z)
    return Z, (S + S.T) / 2
