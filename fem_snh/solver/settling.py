"""Solve a step, again while the terms' lagged quantities change.

Scenes, programs and time steps have this one loop. The terms update multipliers, lagged friction
and pairs of surfaces after each solve (`fem_snh.terms.history.TermHistory`).
"""

from __future__ import annotations

from collections.abc import Callable

from petsc4py import PETSc

from fem_snh.errors import NotSettled
from fem_snh.solver.errors import callback_errors
from fem_snh.solver.outcome import StepOutcome
from fem_snh.solver.protocol import SolvableProblem


def solve_until_settled(
    problem: SolvableProblem,
    snes: PETSc.SNES,
    outcome: StepOutcome,
    judge: Callable[[StepOutcome], None] | None = None,
) -> None:
    """Solve from ``problem.x``, in place, until nothing lagged changes. Collective.

    Parameters
    ----------
    problem : SolvableProblem
    snes : SNES
        Its solver.
    outcome : StepOutcome
        The outcome of the step, to which each solve is added. It has not converged if a solve has
        not, or if lagged quantities do not settle: the reason then says which.
    judge : callable, optional
        Called with the outcome before another solve; it may make the step a failure.
    """
    again = True
    while again:
        with callback_errors():
            snes.solve(None, problem.x)
        outcome.add_solve(snes)
        again = outcome.converged and update_lagged(problem, outcome)
        if again and judge:
            judge(outcome)
            again = outcome.converged


def update_lagged(problem: SolvableProblem, outcome: StepOutcome) -> bool:
    """Update lagged quantities after a solve; return whether to solve again. Collective."""
    try:
        return problem.update_lagged()
    except NotSettled as error:
        outcome.fail_inner(error)
        return False
