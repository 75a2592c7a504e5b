"""Quasi-Newton steps between Newton's: a curved valley is followed without a new Hessian."""

from __future__ import annotations

from petsc4py import PETSc

from fem_snh._petsc import call, ffi
from fem_snh.solver.linesearch import LineSearch

#: A Newton step that left less than this of the residual converges by itself.
_ENOUGH = 0.1


class Corrections:
    """L-BFGS from where a Newton step ended, its first inverse Hessian that step's preconditioner.

    From a rough start a quadratic model holds for a short way only, however well it is minimised.
    A correction costs the energy and the residual that its line search asks for, and one
    application of the preconditioner: no Hessian, no factors, no linear solve. With the factors of
    a filtered Hessian, which are definite, it descends.
    """

    def __init__(
        self, snes: PETSc.SNES, ksp: PETSc.KSP, line: LineSearch, most: int, goal: float
    ) -> None:
        """``most`` corrections after a step; none below ``goal``, a residual's norm [N].

        ``ksp`` has the preconditioner.
        """
        self.snes, self.line, self.most, self.goal = snes, line, most, goal
        self._pc = ksp.getPC()

    def improve(self, before: float, energy: float) -> tuple[float, int]:
        """Go on from the line search's ``trial``, of ``energy``; ``before``: the residual's norm.

        State and residual are in the line search's vectors, then as before. Returns the energy
        there, and the corrections made. Stops where Newton's method does.
        """
        line, count = self.line, 0
        if not self.most or line.f_trial.norm() <= _ENOUGH * before:
            return energy, 0
        x, f, d = (line.trial.duplicate() for _ in range(3))
        memory = self._memory(x)
        for count in range(self.most):
            if line.f_trial.norm() <= self.goal:
                return energy, count
            line.trial.copy(x)
            line.f_trial.copy(f)
            call("MatLMVMUpdate", *(ffi.cast("void *", v.handle) for v in (memory, x, f)))
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

    def _memory(self, x: PETSc.Vec) -> PETSc.Mat:
        """PETSc's limited-memory inverse Hessian for vectors like x, with nothing in it yet."""
        memory = PETSc.Mat().create(x.comm)
        memory.setSizes([x.getSizes()] * 2)
        memory.setType(PETSc.Mat.Type.LMVMBFGS)
        memory.setUp()
        handles = (ffi.cast("void *", v.handle) for v in (memory, x, x))
        call("MatLMVMAllocate", *handles)
        call(
            "MatLMVMSetJ0PC", ffi.cast("void *", memory.handle), ffi.cast("void *", self._pc.handle)
        )
        return memory
