r"""Whether a Hessian is positive definite, without factors.

Conjugate gradients for :math:`H x = b` have the residual :math:`R_k(t) = \prod_j (1 - t/\theta_j)`
times that of the start in each eigenvector of the preconditioned H, with its eigenvalue t and the
Ritz values :math:`\theta_j` (Saad 2011, sec. 6.7). While these are positive, :math:`R_k(t) > 1` for
all negative t. So the part of a residual in an eigenvector of a negative eigenvalue never
decreases: it grows until a direction of negative curvature is met. With a random b that part is
:math:`\|b\|/\sqrt n` on average, and a residual that falls far below leaves no negative eigenvalue.
With the coarse matrix of the deflation, which is definite, H then is (Haynsworth 1968).

A Hessian H of displacement with an unknown pressure may be indefinite at a stable equilibrium: the
matrix of stability is :math:`S = H + B^T C^{-1} B`. If H is definite, so is S. Otherwise the
Lanczos method with :math:`S^{-1}`, the displacement's part of the inverse of the whole matrix,
finds the eigenvalues of S next to zero on either side.
"""

from __future__ import annotations

from math import sqrt

from petsc4py import PETSc

import numpy as np

from fem_snh._petsc import set_operators
from fem_snh.linalg.ssor_cg import context_of
from fem_snh.solver.block_triangular import BlockTriangular
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.saddle_point import frozen_preconditioner, preconditioner_by_blocks
from fem_snh.solver.stability import EquilibriumStability
from fem_snh.solver.step import relative_tolerance

_Reason = PETSc.KSP.ConvergedReason
_INDEFINITE = (_Reason.DIVERGED_INDEFINITE_MAT, _Reason.DIVERGED_INDEFINITE_PC)
#: Nodes up to which factors of one Hessian cost less than a load step (twist of Q2Q1 with 8 cells
#: across, 4,913 nodes: 1.7 of 11 s), and up to which they fit into memory.
_MAX_FACTORED, _MAX_NODES = 5_000, 50_000
#: The residual is reduced to this part of the mean size of a component: a normally distributed one
#: is smaller in 0.4 % of all cases.
_PART = 0.005
#: Iterations after which definiteness is unknown; stable bodies need 20 to 40.
_MAX_IT = 300
#: Lanczos iterations with S^-1, their relative tolerance, and the Ritz value below which an
#: eigenvalue is negative, relative to the largest.
_LANCZOS, _INVERSE_RTOL, _NEGATIVE = 6, 1e-2, -0.01


def negative_eigenvalues(problem: SolvableProblem, ksp: PETSc.KSP) -> int | None:
    """Return `EquilibriumStability.negative_eigenvalues` at a small part of a solve's cost.

    Iterations tell of most stable equilibria that they are; factors count where they do not, and
    that is cheap or there is negative curvature. None if nothing tells; 1 stands for any number in
    bodies that are too large for factors. Collective.

    Parameters
    ----------
    problem : SolvableProblem
        The problem with an unknown pressure, at an equilibrium.
    ksp : PETSc.KSP
        Its linear solver, which is set up anew.
    """
    nodes, iterative = problem.regime.nodes, problem.operator == problem.A
    if iterative:
        problem.jacobian(problem.x, "exact")
        if is_definite(problem, ksp):
            return 0
    if nodes > _MAX_FACTORED and not (iterative and has_negative_curvature(problem, ksp)):
        return None
    if nodes > _MAX_NODES:
        return 1
    return EquilibriumStability(problem).negative_eigenvalues(problem.x)


@callback_errors()
def is_definite(problem: SolvableProblem, ksp: PETSc.KSP) -> bool | None:
    """Return whether the displacement's part of the assembled Hessian is definite. Collective.

    None if iterations do not tell.

    Parameters
    ----------
    problem : SolvableProblem
        The problem, with its exact Hessian assembled.
    ksp : PETSc.KSP
        Its linear solver.
    """
    EquilibriumStability(problem).raise_rotations(problem.x)
    set_operators(ksp, *ksp.getOperators())  # the preconditioner may be that of the filtered one
    ksp.setUp()
    blocks = preconditioner_by_blocks(ksp.getPC())
    cg = blocks.u if isinstance(blocks, BlockTriangular) else ksp
    if context_of(cg) is None:
        return None
    diagonal = problem.A.getDiagonal()
    x, b = cg.getOperators()[0].createVecs()
    # With this factor the components in all eigenvectors are about as large.
    size = len(b.array_r)
    b.array[:] = (noise(problem).array_r * np.sqrt(np.abs(diagonal.array_r)))[:size]
    rtol, max_it = cg.getTolerances()[0], cg.getTolerances()[3]
    cg.setTolerances(rtol=_PART / sqrt(b.getSize()), max_it=_MAX_IT)
    cg.solve(b, x)
    cg.setTolerances(rtol=rtol, max_it=max_it)
    reason = cg.getConvergedReason()
    if reason in _INDEFINITE:
        return False
    return True if reason == _Reason.CONVERGED_RTOL else None


@callback_errors()
def has_negative_curvature(problem: SolvableProblem, ksp: PETSc.KSP) -> bool:
    """Return whether an eigenvalue of S next to zero is negative. Collective.

    Parameters
    ----------
    problem : SolvableProblem
        The problem with an unknown pressure, at an equilibrium.
    ksp : PETSc.KSP
        Its linear solver, which is set up anew.
    """
    assert problem.saddle_point
    size = problem.saddle_point.index_sets["u"].getLocalSize()
    basis, T = [], np.zeros((_LANCZOS, _LANCZOS))
    comm, f, x = problem.comm, noise(problem), problem.x.duplicate()
    problem.jacobian(problem.x, "clamp")
    problem.saddle_point.update_schur_approximation(problem.A)

    def assemble() -> None:
        problem.jacobian(problem.x, "exact")
        EquilibriumStability(problem).raise_rotations(problem.x)

    with (
        relative_tolerance(ksp, _INVERSE_RTOL),
        frozen_preconditioner(ksp, problem.operator, problem.A, assemble),
    ):
        for k in range(_LANCZOS):
            f.array[size:] = 0.0
            f.normalize()
            basis.append(f.array_r[:size].copy())
            ksp.solve(f, x)
            if not ksp.getConvergedReason() > 0:
                return False
            w, Q = x.array_r[:size].copy(), np.array(basis)
            for _ in range(2):  # twice is enough (Parlett 1998, section 6.9)
                part = comm.allreduce(Q @ w)
                T[: k + 1, k] += part
                w -= part @ Q
            ritz = np.linalg.eigvalsh(T[: k + 1, : k + 1], UPLO="U")
            if ritz[0] < _NEGATIVE * np.abs(ritz).max():
                return True
            f.array[:size] = w
    return False


def noise(problem: SolvableProblem) -> PETSc.Vec:
    """Return a vector of numbers between -1 and 1 without any order, zero where constrained.

    They are functions of the coordinates, the same on any number of ranks.
    """
    vector = problem.x.duplicate()
    vector.set(0.0)
    points = problem.coordinates / problem.length
    phases = points @ np.sqrt([[2e4, 3e4, 5e4], [7e4, 11e4, 13e4], [17e4, 19e4, 23e4]])
    values = np.sin(1e3 * np.sin(phases + np.sqrt([29.0, 31.0, 37.0])))
    values = values[:, : problem.regime.dimension]
    vector.array[: values.size] = values.ravel()
    problem.project(vector.array)
    return vector
