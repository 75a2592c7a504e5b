"""Where Newton's method starts when the load changes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from petsc4py import PETSc

from fem_snh.choices import PREDICTORS
from fem_snh.errors import choose

_CUT_SHORT = PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT


@dataclass
class Predictor:
    """Moves ``problem.x`` from the equilibrium of one load to a first guess for the next.

    none         the new boundary values, nothing else moves
    extrapolate  on along the last step, in proportion; tangent where there was none
    tangent      the linearised response to the change of load: one linear solve

    Attributes
    ----------
    before : load and vector of the equilibrium before the present one, which extrapolation goes on
        from; None if there is none. All that it remembers between steps.
    """

    problem: Any
    snes: PETSc.SNES
    kind: str = "tangent"
    before: tuple[float, PETSc.Vec] | None = field(default=None, init=False)

    def __post_init__(self) -> None:
        choose("predictor", self.kind, PREDICTORS)

    def predict(self, load: float) -> int:
        """Set the load and the first guess; the linear iterations it took. Collective."""
        problem, x, old = self.problem, self.problem.x, self.problem.load
        here, linear = x.copy(), 0
        problem.set_load(load)
        if self.kind == "extrapolate" and self.before is not None:
            earlier, before = self.before
            x.axpy((load - old) / (old - earlier), here)
            x.axpy(-(load - old) / (old - earlier), before)
        elif self.kind != "none":
            linear = self._tangent()
        problem.prescribe(x)
        self._last = (old, here)
        return linear

    def accept(self) -> None:
        """The step from the last prediction converged: extrapolation may use it."""
        self.before = self._last

    def _tangent(self) -> int:
        """x -= H^-1 (residual at the new load + H_free,prescribed * jump of the boundary values).

        The product is a central difference of residuals along the jump: the matrix has no
        columns for prescribed values. H is clamped, so that CG cannot fail.
        """
        problem, x = self.problem, self.problem.x
        jump = x.copy()
        problem.prescribe(jump)
        jump.axpy(-1.0, x)
        size = jump.norm(PETSc.NormType.INFINITY)
        right, other, moved = (x.duplicate() for _ in range(3))
        problem.residual(x, right)
        if size > 0:
            h = 1e-6 * problem.length / size
            for sign in (1, -1):
                moved.waxpy(sign * h, jump, x)
                problem.residual(moved, other)
                right.axpy(sign / (2 * h), other)
        problem.jacobian(x, "clamp")
        ksp = self.snes.getKSP()
        ksp.setOperators(problem.A)
        tolerance = ksp.getTolerances()[0]
        ksp.setTolerances(rtol=max(tolerance, 1e-2))
        ksp.solve(right, other)
        ksp.setTolerances(rtol=tolerance)
        # Newton's own linear solve will say what is wrong; a direction that is not one hides it.
        if ksp.getConvergedReason() > 0 or ksp.getConvergedReason() == _CUT_SHORT:
            x.axpy(-1.0, other)
        return int(ksp.getIterationNumber())
