"""One linearised step to the present load: the step of semi-implicit Euler."""

from __future__ import annotations

from math import isfinite

from petsc4py import PETSc

from fem_snh._petsc import factors_out_of_memory
from fem_snh.solver.garbage import clean
from fem_snh.solver.outcome import StepOutcome, linear_failure, update_lagged
from fem_snh.solver.protocol import SolvableProblem
from fem_snh.solver.step import ForcingTerm, Iteration, State

#: Length of the central difference along the boundary's motion, relative to the body: about the
#: cube root of the rounding error, where truncation and rounding are balanced.
_DIFFERENCE = 1e-6


def linearised_residual(problem: SolvableProblem) -> PETSc.Vec:
    """Return r + H_fc j at ``problem.x``, whose boundary values are those of another load.

    r is the residual at the present load, j the jump of the boundary values, H_fc the block of
    free rows and constrained columns. The assembled matrix has no such columns, so H_fc j is a
    central difference of residuals along j. Collective.
    """
    x = problem.x
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
    return rhs


def take_step(problem: SolvableProblem, factor: float, step: PETSc.Vec) -> None:
    """Add a multiple of a step to ``problem.x``, along the paths that a problem needs."""
    paths, x = problem.retraction, problem.x
    if paths and paths.exact:
        paths(x.copy(), step, factor, x)
    else:
        x.axpy(factor, step)


class SemiImplicit:
    """Semi-implicit Euler: one linearised step of backward Euler (Baraff & Witkin 1998).

    Hessian and linear solver are those of the SNES, without forcing terms. The residual of the
    linear system, computed in double precision, must not exceed ``-ksp_rtol`` times its right-hand
    side, nor times the forces that act: a stiff body may begin with elastic forces far above its
    loads. What rounding permits is enough. A solution that misses it is refined; then sparse
    factors replace the linear solver, unless the user chose it; otherwise the step fails. There is
    no line search.

    Parameters
    ----------
    problem : SolvableProblem
    snes : SNES
        The SNES of the problem, whose context is `ProjectedNewton`.
    """

    def __init__(self, problem: SolvableProblem, snes: PETSc.SNES) -> None:
        self._problem, self._snes = problem, snes

    def solve(self) -> StepOutcome:
        """Make the step from ``problem.x``, in place. Collective.

        The SNES has the outcome's converged reason and iteration, as after a solve of its own.
        """
        outcome = self._step()
        if outcome.converged:  # lagged quantities follow once a step
            update_lagged(self._problem, outcome)
        self._snes.getPythonContext().history = outcome.history
        name = outcome.reason.partition(":")[0]
        self._snes.setConvergedReason(getattr(PETSc.SNES.ConvergedReason, name))
        # petsc4py frees dropped objects only when told to, for each communicator.
        clean([self._problem.x.comm])
        return outcome

    def _step(self) -> StepOutcome:
        """Make the step."""
        problem, x = self._problem, self._problem.x
        start, d = State(x, linearised_residual(problem)), x.duplicate()
        # A new one for each step: a run that is resumed has no memory of the last one's Hessian.
        context = self._snes.getPythonContext()
        forcing = ForcingTerm(0.0, self._snes.getKSP().getTolerances()[0] * context.force_at(x))
        direction = context.direction(self._snes, forcing, True)
        found = direction.compute(start, d)
        norm = start.residual.norm()
        iteration = Iteration(norm, 0.0, found.filter, found.filtered_points, found.linear, 1.0)
        outcome = StepOutcome(False, "CONVERGED_ITS", norm, [iteration])
        outcome.linear_residual = found.residual
        if norm > 0 and (found.slope is None or found.lack):
            linear = self._snes.getKSP()
            outcome.reason = linear_failure(linear, found)
            outcome.out_of_memory = found.out_of_memory or factors_out_of_memory(linear.getPC())
            return outcome
        if norm > 0:
            take_step(problem, 1.0, d)
        problem.prescribe(x)
        if problem.has_energy and not isfinite(problem.energy(x)):
            outcome.reason = "DIVERGED_FUNCTION_DOMAIN"
            return outcome
        problem.residual(x, start.residual)
        outcome.residual = start.residual.norm()
        outcome.converged = isfinite(outcome.residual)
        if not outcome.converged:
            outcome.reason = "DIVERGED_FNORM_NAN"
        elif found.remedy:
            outcome.reason += f": {found.remedy}"
        return outcome
