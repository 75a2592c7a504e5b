"""Predict the solution at the next load: the first guess of Newton's method.

The load stepping (``fem_snh.runs.stepping``) calls ``predict`` before each solve.
"""

from __future__ import annotations

from petsc4py import PETSc

from fem_snh.choices import DEFAULT_PREDICTOR, PREDICTORS
from fem_snh.errors import choose
from fem_snh.solver.forcing import relative_tolerance
from fem_snh.solver.protocol import NonlinearProblem

_MAX_IT = PETSc.KSP.ConvergedReason.DIVERGED_MAX_IT
#: Smallest relative tolerance of the tangent's linear solve: the linear model is no more accurate.
_RTOL = 1e-2
#: Length of the central difference along the boundary's motion, relative to the body: about the
#: cube root of the rounding error, where truncation and rounding are balanced.
_DIFFERENCE = 1e-6


class Predictor:
    """Predictor that moves ``problem.x`` from the equilibrium at one load to a guess at the next.

    ===============  ==============================================================================
    ``none``         the new boundary values; the free unknowns keep theirs
    ``extrapolate``  the last step's displacement, continued in proportion to the load; the tangent
                     at the first step
    ``tangent``      the linearised response to the change of load: one linear solve
    ===============  ==============================================================================

    Parameters
    ----------
    problem : NonlinearProblem
    snes : SNES
        The SNES whose linear solver is used.
    kind : str

    Attributes
    ----------
    before : (float, Vec) or None
        Load and unknowns of the equilibrium before the present one, from which it extrapolates;
        None if there is none. Nothing else is kept between steps.
    """

    def __init__(
        self, problem: NonlinearProblem, snes: PETSc.SNES, kind: str = DEFAULT_PREDICTOR
    ) -> None:
        self.problem, self.snes = problem, snes
        self.kind = choose("predictor", kind, PREDICTORS)
        self.before: tuple[float, PETSc.Vec] | None = None

    def predict(self, load: float) -> int:
        """Set the load and the first guess; return the linear iterations used. Collective."""
        problem, x, old = self.problem, self.problem.x, self.problem.load
        present, linear = x.copy(), 0
        problem.set_load(load)
        if self.kind == "extrapolate" and self.before is not None:
            earlier, before = self.before
            x.axpy((load - old) / (old - earlier), present)
            x.axpy(-(load - old) / (old - earlier), before)
        elif self.kind != "none":
            linear = self._tangent()
        problem.prescribe(x)
        self._last = (old, present)
        return linear

    def accept(self) -> None:
        """Keep the start of the last prediction, whose step converged, for extrapolation."""
        self.before = self._last

    def _tangent(self) -> int:
        """Subtract H^-1 (r + H_fc j) from x; return the linear iterations.

        r is the residual at the new load, j the jump of the boundary values, H_fc the block of
        free rows and constrained columns. The assembled matrix has no such columns, so H_fc j is a
        central difference of residuals along j. H is clamped, so that CG cannot fail.
        """
        problem, x = self.problem, self.problem.x
        jump = x.copy()
        problem.prescribe(jump)
        jump.axpy(-1.0, x)
        size = jump.norm(PETSc.NormType.INFINITY)
        rhs, other, moved = (x.duplicate() for _ in range(3))
        problem.residual(x, rhs)
        if size > 0:
            h = _DIFFERENCE * problem.length / size
            for sign in (1, -1):
                moved.waxpy(sign * h, jump, x)
                problem.residual(moved, other)
                rhs.axpy(sign / (2 * h), other)
        problem.jacobian(x, "clamp")
        ksp = self.snes.getKSP()
        ksp.setOperators(problem.operator, problem.A)
        with relative_tolerance(ksp, max(ksp.getTolerances()[0], _RTOL)):
            ksp.solve(rhs, other)
        # After any other failure the guess is the old state: Newton's linear solve will report it.
        if ksp.getConvergedReason() > 0 or ksp.getConvergedReason() == _MAX_IT:
            x.axpy(-1.0, other)
        return int(ksp.getIterationNumber())
