"""The linear solver of Hessians that are not symmetric: of forces without an energy.

A follower pressure on a surface with a free edge, or a residual of UFL, has a derivative that is
not symmetric. Newton's method with its symmetric part converges linearly at best: a plate under
such a pressure takes 20 times as many iterations. Filtered Hessians are those of symmetric parts,
and have the SNES's own linear solver.
"""

from __future__ import annotations

from functools import cached_property

from petsc4py import PETSc

from fem_snh._petsc import expect_singular_matrix
from fem_snh.linalg.direct_solver import set_asymmetric_factors
from fem_snh.solver.linear_choice import MAX_NODES, LinearChoice
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.saddle_point import preconditioner_by_blocks

#: Linear solvers that need a symmetric matrix, and preconditioners that do.
_SYMMETRIC = {
    "cg",
    "pipecg",
    "groppcg",
    "fcg",
    "minres",
    "symmlq",
    "nash",
    "stcg",
    "gltr",
    "python",
}
#: Iterations of GMRES, which keeps all of its vectors; then the solution is used as it is. A strip
#: of 3,157 nodes takes 60 to 90 of them for a residual of 1e-3.
_MAX_IT = 200


class AsymmetricSolver:
    """The linear solver of a problem whose exact Hessian may not be symmetric.

    It has sparse factors L U, or GMRES with incomplete factors of each rank's rows where inertia
    makes the matrix well conditioned, or where factors would need much memory. A solver that the
    user chose is kept, if it needs no symmetric matrix, and that of a saddle-point problem is.

    Parameters
    ----------
    problem : SolvableProblem
        The problem.
    own : PETSc.KSP
        The linear solver of symmetric Hessians, set up by the options.
    choice : LinearChoice
        Why it was chosen.
    """

    def __init__(self, problem: SolvableProblem, own: PETSc.KSP, choice: LinearChoice) -> None:
        self._problem, self._own, self._choice = problem, own, choice

    @property
    def needed(self) -> bool:
        """Whether the problem's last Hessian is not symmetric."""
        return self._problem.asymmetric

    @cached_property
    def ksp(self) -> PETSc.KSP:
        """The solver, created when a Hessian needs it. Collective."""
        own, problem, regime = self._own, self._problem, self._problem.regime
        symmetric = own.getType() in _SYMMETRIC or own.getPC().getType() == PETSc.PC.Type.CHOLESKY
        if preconditioner_by_blocks(own.getPC()) or not symmetric:
            return own
        ksp = PETSc.KSP().create(own.comm)
        rtol, atol = own.getTolerances()[:2]
        set_asymmetric_factors(ksp)
        if problem.pressure_level_is_free:
            expect_singular_matrix(ksp)
        chosen = not self._choice.reason  # by the user
        large = regime.dimension == 3 and (regime.inertia or regime.nodes > MAX_NODES)
        iterative = not self._choice.direct and (chosen or large)
        if iterative:
            ksp.getPC().setType(PETSc.PC.Type.BJACOBI)
        if iterative or problem.operator != problem.A:  # the factors lack matrices of rank one
            ksp.setType(PETSc.KSP.Type.GMRES)
            ksp.setGMRESRestart(_MAX_IT)
            ksp.setTolerances(rtol=rtol, atol=atol, max_it=_MAX_IT)
        return ksp

    def destroy(self) -> None:
        """Destroy the solver, if it is not the problem's own. Collective."""
        if "ksp" in self.__dict__ and self.ksp != self._own:
            self.ksp.destroy()
