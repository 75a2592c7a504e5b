"""Solve one step to a load or a time: the one driver of scenes and of dolfinx programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.choices import DEFAULT_PREDICTOR
from fem_snh.errors import NotSettled
from fem_snh.problem.problem import Problem
from fem_snh.solver.linear_choice import MAX_NODES
from fem_snh.steps.condensation import CellPressures
from fem_snh.steps.poisson_continuation import PoissonContinuation

if TYPE_CHECKING:
    from fem_snh.steps.rescue import Rescue
    from fem_snh.steps.time_steps import TimeSteps


class StepSolver:
    """Solve a step: predict, solve until nothing lagged changes, accept or restore the start.

    `Stepper`, `fem_snh.nonlinear_problem.NonlinearProblem` and
    `fem_snh.dynamic_problem.DynamicProblem` make their steps by it.

    Parameters
    ----------
    problem : Problem
        The discretised problem.
    snes : PETSc.SNES
        Its nonlinear solver.
    predictor : str, optional
        First guess of a step: see `fem_snh.solver.Predictor`.
    motion : TimeSteps, optional
        The integration in time.
    continuation : PoissonContinuation, optional
        Solves with other Poisson's ratios, which improve the first guess.
    pressures : CellPressures, optional
        Solves each step with the cell pressures as unknowns first.
    blend : callable, optional
        Moves the flesh with the bones in it: see `fem_snh.solver.Predictor`.

    Attributes
    ----------
    predictor : Predictor
        The predictor, which keeps the equilibrium that it extrapolates from.
    guessed : callable or None
        Called when ``problem.x`` is the first guess of a step.
    """

    def __init__(
        self,
        problem: Problem,
        snes: PETSc.SNES,
        predictor: str = DEFAULT_PREDICTOR,
        motion: TimeSteps | None = None,
        continuation: PoissonContinuation | None = None,
        pressures: CellPressures | None = None,
        blend: Callable[[PETSc.Vec, float, float], None] | None = None,
    ) -> None:
        self.problem, self.snes, self.motion = problem, snes, motion
        self.guessed: Callable[[], None] | None = None
        self.continuation, self.pressures = continuation, pressures
        extrapolate = motion.extrapolate if motion else None
        response = pressures.tangent if pressures else None
        self.predictor = solver.Predictor(problem, snes, predictor, extrapolate, blend, response)
        self._rescue: Rescue | None = None
        self._rescued = False  # whether the last step was
        self._linearised = motion is not None and motion.semi_implicit

    def solve(
        self,
        load: float,
        judge: Callable[[solver.StepOutcome], None] | None = None,
        *,
        predict: bool = True,
        restore: bool = True,
    ) -> solver.StepOutcome:
        """Solve from the problem's state to a load. Collective.

        Parameters
        ----------
        load : float
            The load at the step's end, 0 to 1.
        judge : callable, optional
            Called with the outcome of a step that converged, which it may make a failure.
        predict : bool
            Whether the first guess is a prediction; otherwise it is the present state.
        restore : bool
            Whether a step that fails ends with load and state of its start; otherwise with its last
            iterate.
        """
        problem, motion = self.problem, self.motion
        start, before, history = problem.x.copy(), problem.load, list[solver.Iteration]()
        for number, rescues in enumerate(self._attempts()):
            if number:
                start.copy(problem.x)
                problem.set_load(before)
            tried = self._attempt(load, predict, rescues)
            history += tried.history
            if tried.converged or not rescues:
                outcome = tried
            if tried.converged:
                self._rescued = rescues
                break
        outcome.history = history
        if judge and outcome.converged:
            judge(outcome)
        if outcome.converged:
            if predict:
                self.predictor.accept()
            if motion:
                motion.end_step()
            problem.history.end_step(problem.split(problem.x)[0])
        elif restore:
            start.copy(problem.x)
            problem.set_load(before)
            if motion:
                motion.cancel_step()
        return outcome

    def _attempt(self, load: float, predict: bool, rescues: bool) -> solver.StepOutcome:
        """Solve from the problem's state to a load, or rescue the step."""
        problem, context = self.problem, self.snes.getPythonContext()
        problem.history.begin_step(problem.split(problem.x)[0])
        if self.motion:
            context.earlier_force, context.least_load = self.motion.begin_step(load)
        if self.pressures:
            self.pressures.begin_step()
        with solver.callback_errors():
            return self._solve(load, predict, rescues)

    @property
    def can_rescue(self) -> bool:
        """Whether steps that fail are solved again: static ones with contact."""
        problem = self.problem
        touches = any(term.is_contact for term in problem.terms) and problem.motion is None
        assembled = problem.operator == problem.A and bool(problem.regions)
        return touches and assembled and problem.regime.nodes <= MAX_NODES

    def _attempts(self) -> Sequence[bool]:
        """Return whether each attempt of a step rescues it: first, after a step that needed it."""
        if not self.can_rescue:
            return [False]
        return [True, False] if self._rescued else [False, True]

    def _solve(self, load: float, predict: bool, rescues: bool) -> solver.StepOutcome:
        """Solve at a load from a first guess; return the outcome of all solves."""
        problem, outcome = self.problem, solver.StepOutcome()
        if self._linearised:
            problem.set_load(load)
            return solver.solve_linearised(self.problem, self.snes)
        try:
            if predict:
                outcome.predicted = self.predictor.predict(load, stay=rescues)
            else:
                problem.set_load(load)
        except NotSettled as error:
            outcome.fail_inner(error)
            return outcome
        if self.guessed:
            self.guessed()
        if rescues:
            from fem_snh.steps.rescue import Rescue  # few steps need it

            self._rescue = self._rescue or Rescue(problem, self.snes)
            if left := self.snes.getPythonContext().left.first:
                left.copy(problem.x)
                problem.prescribe(problem.x)
            self._rescue.solve(outcome)
            return outcome
        if self.continuation:
            outcome.history += self.continuation.solve(problem)
        if self.pressures:
            self.pressures.solve()
            outcome.history += self.pressures.history
        # Forces that are small beside others, as the weight of a body in tension, count too.
        self.snes.getPythonContext().force_iteration = self.motion is not None
        judge = self._judge_slide if self.can_rescue and not self._rescued else None
        solver.solve_until_settled(problem, self.snes, outcome, judge)
        return outcome

    def _judge_slide(self, outcome: solver.StepOutcome) -> None:
        """Make a step a failure that has left an unstable state for surfaces that slide off.

        It is at a minimum for facets that points do not touch there. Further solves begin far from
        the path, and alternate, or end at a state that depends on their order.
        """
        change = self.problem.history.change
        if outcome.left_unstable and change.slid_off:
            what = f"{change.what} is {change.ratio:.3g} times the tolerance"
            outcome.fail_inner(NotSettled(f"{what} as surfaces slide off an unstable state"))

    def destroy(self) -> None:
        """Destroy the auxiliary solvers. Collective."""
        for auxiliary in (self.continuation, self.pressures):
            if auxiliary:
                auxiliary.destroy()
