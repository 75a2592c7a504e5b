"""L-BFGS iterations between Newton steps, which need no new Hessian."""

from __future__ import annotations

from typing import NamedTuple

from petsc4py import PETSc

from fem_snh._petsc import call
from fem_snh.solver.line_search import LineSearch
from fem_snh.solver.step import State, Step


class _Memory(NamedTuple):
    """PETSc's limited-memory inverse Hessian, and vectors of an iteration.

    ``travelled`` is the sum of the steps: their differences are steps where the unknowns' are not.
    """

    inverse: PETSc.Mat
    start: State
    d: PETSc.Vec
    travelled: PETSc.Vec


class QuasiNewton:
    """L-BFGS from the end of a Newton step (Nocedal & Wright 2006, alg. 7.4 and 7.5).

    The preconditioner of the Newton step is the initial inverse Hessian. Far from a solution a
    quadratic model is accurate over a short step only, so an exact minimiser of it is not worth its
    cost. An L-BFGS iteration costs the energies and residuals of its line search and one
    application of the preconditioner: no Hessian, no factorisation, no linear solve. The
    preconditioner of a filtered Hessian is positive definite, so every direction descends. The
    iterations end once the residual has fallen to ``rtol``: Newton's method is faster near a
    solution.

    Parameters
    ----------
    ksp : KSP
        The linear solver whose preconditioner is used.
    line_search : LineSearch
    max_it : int
        Greatest number of iterations after one Newton step.
    rtol, atol : float
        The iterations end once the residual's norm is below ``rtol`` times its value before the
        Newton step, or below ``atol`` [N].
    """

    def __init__(
        self, ksp: PETSc.KSP, line_search: LineSearch, max_it: int, rtol: float, atol: float
    ) -> None:
        self.max_it, self.rtol, self.atol = max_it, rtol, atol
        self._line_search, self._pc = line_search, ksp.getPC()
        self._memory: _Memory | None = None

    def continue_from(self, step: Step, start_norm: float) -> Step:
        """Iterate from the end of a Newton step that began at a residual of ``start_norm`` [N].

        Updates and returns ``step``.
        """
        end, enough = step.end, max(self.rtol * start_norm, self.atol)
        assert end is not None
        while step.lbfgs < self.max_it and end.residual.norm() > enough:
            inverse, start, d, travelled = self._allocated(end)
            if not step.lbfgs:
                call("MatLMVMReset", inverse, 0)
            end.copy_to(start)
            curved = self._line_search.follows_paths
            call("MatLMVMUpdate", inverse, travelled if curved else start.x, start.residual)
            inverse.solve(start.residual, d)
            d.scale(-1.0)
            slope = float(start.residual.dot(d))
            searched = self._line_search.search(start, d, slope, end) if slope < 0 else Step()
            if not searched.end:
                start.copy_to(end)
                break
            if curved:
                travelled.axpy(searched.length, d)
            step.lbfgs += 1
        return step

    def _allocated(self, like: State) -> _Memory:
        """Return the vectors and PETSc's matrix, created by the first call."""
        if self._memory is None:
            start, d = State.like(like), like.x.duplicate()
            inverse = PETSc.Mat().create(d.comm)
            inverse.setSizes([d.getSizes()] * 2)
            inverse.setType(PETSc.Mat.Type.LMVMBFGS)
            inverse.setUp()
            call("MatLMVMAllocate", inverse, start.x, start.residual)
            call("MatLMVMSetJ0PC", inverse, self._pc)
            travelled = d.duplicate()
            travelled.set(0.0)
            self._memory = _Memory(inverse, start, d, travelled)
        return self._memory
