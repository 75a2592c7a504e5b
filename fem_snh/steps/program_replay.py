"""The load of a program's steps, and the repetition of these steps for error estimates."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, NamedTuple

from fem_snh import _dolfinx, solver
from fem_snh._petsc import default_options
from fem_snh.accuracy.path_errors import Path
from fem_snh.arrays import Array
from fem_snh.assembly.elements import Element
from fem_snh.problem.conditions import LoadFunction
from fem_snh.problem.definition import lifted_problem
from fem_snh.problem.problem import Problem
from fem_snh.steps.stepping import Stepper, StepSolver


class SolverChoice(NamedTuple):
    """The solver's arguments of `fem_snh.NonlinearProblem`, which a repetition uses again."""

    prefix: str
    options: Mapping[str, Any]
    hessian: str | None
    globalization: str | None
    predictor: str


@contextmanager
def follow_load(
    problem: Problem, load: LoadFunction, set_load: Callable[[float], None] | None
) -> Iterator[None]:
    """Make boundary values and terms depend on the load within a ``with`` block.

    Parameters
    ----------
    problem : Problem
        The problem, at the state in which its steps begin.
    load : LoadFunction
        The function that the problem's conditions call at each load.
    set_load : callable or None
        Sets constants, functions and boundary values for a load from 0 to 1. None: the boundary
        values change linearly with the load, from the present state to the given values.
    """
    load.function = set_load
    if set_load is None:
        problem.dirichlet.start_from(problem.x)
    try:
        yield
    finally:
        load.function = problem.dirichlet.offset = None


def program_path(
    problem: Problem,
    load: LoadFunction,
    choice: SolverChoice,
    stepper: Stepper,
    following: Callable[[Problem], AbstractContextManager[Any]] = nullcontext,
    velocity: Callable[[Array], Array] | None = None,
) -> Path | None:
    """Return the path of steps that begin now; None if their end does not depend on the path.

    Parameters
    ----------
    problem : Problem
        The problem, at the state in which the path begins.
    load : LoadFunction
        The function that the problem's conditions call at each load.
    choice : SolverChoice
        The solver of a repetition.
    stepper : Stepper
        The steps.
    following : callable, optional
        ``following(problem)`` returns a context in which a problem follows the load: see
        `follow_load`. Default: for a motion in time, a context that does nothing.
    velocity : callable, optional
        The initial velocity of a motion in time: see `Dynamics.start`.
    """
    if not problem.depends_on_path:
        return None
    problem.split(problem.x)
    start = _dolfinx.function(problem.V, "start")
    start.x.array[:] = problem.u.x.array

    @contextmanager
    def repeat(steps: int, element: Element | None, stiffer: float) -> Iterator[Stepper]:
        """Provide the `Stepper` of a repetition; at the end set constants to load 1 again."""
        chosen = choice.hessian, choice.globalization
        if element and element.has_pressure:  # whose defaults are those of a saddle-point problem
            chosen = None, None
        again = lifted_problem(problem, element or problem.element, start)
        again.scale_penalties(stiffer)
        with following(again), default_options(choice.prefix, choice.options):
            snes = solver.create(again, *chosen, choice.prefix)
            step = StepSolver(again, snes, choice.predictor)
            try:
                if step.motion:
                    step.motion.start(again, velocity)
                else:
                    again.set_load(0.0)
                    again.prescribe(again.x)
                yield Stepper(step, steps)
            finally:
                load(1.0)
                step.destroy()
                solver.destroy(snes)

    return Path(stepper, repeat)
