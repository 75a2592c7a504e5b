"""Quasi-Newton steps between Newton's: a curved valley is followed without a new Hessian."""

from __future__ import annotations

from functools import cached_property

from petsc4py import PETSc

from fem_snh._petsc import call
from fem_snh.solver.line_search import LineSearch

#: A step that left less than this of the residual: Newton's method converges by itself.
CONVERGING = 0.1


class Corrections:
    """L-BFGS from where a Newton step ended, its first inverse Hessian that step's preconditioner.

    From a rough start a quadratic model holds for a short way only, however well it is minimised.
    A correction costs the energy and the residual that its line search asks for, and one
    application of the preconditioner: no Hessian, no factors, no linear solve. With the factors of
    a filtered Hessian, which are definite, it descends. It goes on until Newton's method, which is
    faster near a solution, can be expected to converge.
    """

    def __init__(self, ksp: PETSc.KSP, line: LineSearch, most: int, goal: float) -> None:
        """``most`` corrections after a step; none below ``goal``, a residual's norm [N].

        ``ksp`` has the preconditioner.
        """
        self.line, self.most, self.goal = line, most, goal
        self._pc = ksp.getPC()

    def improve(self, before: float, energy: float) -> tuple[float, int]:
        """Go on from the line search's ``trial``, of ``energy``; ``before``: the residual's norm.

        State and residual are in the line search's vectors, then as before. Returns the energy
        there, and the corrections made. Stops where the residual has become small.
        """
        line, enough = self.line, max(CONVERGING * before, self.goal)
        for count in range(self.most):
            if line.f_trial.norm() <= enough:
                return energy, count
            memory, x, f, d = self._vectors
            if not count:
                call("MatLMVMReset", memory, 0)
            line.trial.copy(x)
            line.f_trial.copy(f)
            call("MatLMVMUpdate", memory, x, f)
            memory.solve(f, d)
            d.scale(-1.0)
            slope = float(f.dot(d))
            found = line.search(x, d, energy, slope) if slope < 0 else None
            if found is None:
                x.copy(line.trial)
                f.copy(line.f_trial)
                return energy, count
            energy = found[1]
        return energy, self.most

    @cached_property
    def _vectors(self) -> tuple[PETSc.Mat, PETSc.Vec, PETSc.Vec, PETSc.Vec]:
        """PETSc's limited-memory inverse Hessian; a state, its residual, and a direction."""
        x, f, d = (self.line.trial.duplicate() for _ in range(3))
        memory = PETSc.Mat().create(x.comm)
        memory.setSizes([x.getSizes()] * 2)
        memory.setType(PETSc.Mat.Type.LMVMBFGS)
        memory.setUp()
        call("MatLMVMAllocate", memory, x, f)
        call("MatLMVMSetJ0PC", memory, self._pc)
        return memory, x, f, d
