"""The steps of a program, which it takes, and which estimates of errors follow again."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from fem_snh import _dolfinx, solver
from fem_snh._petsc import default_options
from fem_snh.accuracy.goal_errors import ElementDoesNotFit, NoEstimate, depends_on_path
from fem_snh.accuracy.goals import Goal
from fem_snh.accuracy.path_errors import Followed, Path, end_of
from fem_snh.assembly.boundary_conditions import StartPath
from fem_snh.assembly.elements import Element
from fem_snh.errors import BadInput
from fem_snh.problem.conditions import LoadFunction
from fem_snh.problem.definition import lifted_problem
from fem_snh.problem.problem import Problem
from fem_snh.steps.stepping import Stepper, StepSolver

Array = npt.NDArray[np.float64]


class SolverChoice(NamedTuple):
    """What a program gave for its solver: arguments of `fem_snh.NonlinearProblem`."""

    prefix: str
    options: Mapping[str, Any]
    hessian: str | None
    globalization: str | None
    predictor: str


class Loading:
    """How boundary values and terms of a program follow the load.

    Parameters
    ----------
    problem : Problem
        The problem, at the state in which the steps begin.
    load : LoadFunction
        What its conditions and terms call at each load.
    set_load : callable or None
        Sets constants, functions and boundary values for a load from 0 to 1; None: the boundary
        values go from those of the present state to the given ones.
    """

    def __init__(
        self, problem: Problem, load: LoadFunction, set_load: Callable[[float], None] | None
    ) -> None:
        self._conditions, self._load, self._set_load = problem.dirichlet, load, set_load
        self._from = problem.x.copy() if set_load is None else None

    @contextmanager
    def applied(self) -> Iterator[None]:
        """Let conditions and terms follow the load for the duration of a ``with`` block."""
        self._load.function = self._set_load
        if self._from:
            self._conditions.start_from(self._from, StartPath())
        try:
            yield
        finally:
            self._load.function = self._conditions.path = None


class ProgramPath(Path):
    """Load or time steps of a program: see `fem_snh.accuracy.path_errors.Path`. Collective.

    Parameters
    ----------
    problem : Problem
        The problem, at the state in which the path begins.
    load : LoadFunction
        What its conditions and terms call at each load.
    choice : SolverChoice
        The solver.
    stepper : Stepper
        The steps.
    applied : callable, optional
        Returns a ``with`` block in which ``load`` has its function: see `Loading.applied`. Default:
        it has one always, as in time.
    velocity : callable, optional
        The initial velocity of a motion in time: see `Dynamics.start`.
    """

    def __init__(
        self,
        problem: Problem,
        load: LoadFunction,
        choice: SolverChoice,
        stepper: Stepper,
        applied: Callable[[], AbstractContextManager[None]] = nullcontext,
        velocity: Callable[[Array], Array] | None = None,
    ) -> None:
        self._problem, self._load, self._applied = problem, load, applied
        self._stepper, self._choice = stepper, choice
        self._velocity = velocity
        problem.split(problem.x)
        self._start = _dolfinx.function(problem.V, "start")
        self._start.x.array[:] = problem.u.x.array

    @classmethod
    def of(cls, problem: Problem, *given: Any, **motion: Any) -> ProgramPath | None:
        """Return the path of steps that begin now; None where the end does not depend on it."""
        return cls(problem, *given, **motion) if depends_on_path(problem) else None

    @property
    def steps(self) -> int:
        """The number of equal steps; it raises NoEstimate if they have not reached their end."""
        if not self._stepper.done:
            raise NoEstimate("the steps have not reached their end")
        return self._stepper.steps

    @property
    def taken(self) -> int:
        """The number of steps taken."""
        return self._stepper.taken

    def follow(
        self, steps: int, goals: Sequence[Goal], element: Element | None, stiffer: float
    ) -> Followed:
        """See `fem_snh.accuracy.path_errors.Path`. Constants have their values at the end again."""
        chosen, choice = element or self._problem.element, self._choice
        if element and element.has_pressure:  # whose defaults are those of a saddle-point problem
            choice = choice._replace(hessian=None, globalization=None)
        with self._applied():
            try:
                return self._followed(steps, goals, chosen, choice, stiffer)
            except BadInput as error:  # a material without a volume term, a term of its own
                raise ElementDoesNotFit(f"{chosen.name} does not fit: {error}") from None
            finally:
                self._load(1.0)

    def _followed(
        self,
        steps: int,
        goals: Sequence[Goal],
        element: Element,
        choice: SolverChoice,
        stiffer: float,
    ) -> Followed:
        again = lifted_problem(self._problem, element, self._start)
        again.scale_penalties(stiffer)
        with default_options(choice.prefix, choice.options):
            snes = solver.create(again, choice.hessian, choice.globalization, choice.prefix)
            step = StepSolver(again, snes, choice.predictor)
            try:
                if step.motion:
                    step.motion.start(again, self._velocity)
                else:
                    again.set_load(0.0)
                    again.prescribe(again.x)
                what = f"with {steps} steps of {element.name}"
                return end_of(Stepper(step, steps), again, goals, what)
            finally:
                step.destroy()
                solver.destroy(snes)
