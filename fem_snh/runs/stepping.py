"""Load stepping from 0 to 1: prediction, solution, rollback and halving of failed steps."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.errors import NotSettled
from fem_snh.fem.probes import Probes
from fem_snh.fem.problem import Problem
from fem_snh.runs.cell_pressures import CellPressures
from fem_snh.runs.jump import Jump, JumpDetector
from fem_snh.runs.poisson_continuation import PoissonContinuation
from fem_snh.runs.step_size import StepSize

if TYPE_CHECKING:
    from fem_snh.runs.bones import BoneRecords
    from fem_snh.runs.transient import Transient


class Stepper:
    """An iterator over the attempted load increments; it yields a row of run.json for each.

    The first increment starts from the problem's load. Every multiple of 1/steps is reached. A
    step that fails is rolled back and halved; after a step that converges the size doubles.

    Parameters
    ----------
    problem : Problem
        The discretised problem.
    snes : PETSc.SNES
        Its nonlinear solver.
    steps : int
        Number of nominal load steps.
    predictor : str
        Initial guess of a step: see `fem_snh.solver.Predictor`.
    probes : Probes, optional
        Points whose displacement is added to each row.
    continuation : PoissonContinuation, optional
        Solves with other Poisson's ratios, which improve the initial guess.
    transient : Transient, optional
        The time integration, if the scene has one.
    bones : BoneRecords, optional
        Bones whose forces are added to each row.
    pressures : CellPressures, optional
        Solves each step with the cell pressures as unknowns first.

    Attributes
    ----------
    size : StepSize
        The size of the next step.
    done : bool
        Whether load 1 is reached.
    seconds : float
        Elapsed seconds of the steps.
    processor : float
        This rank's processor seconds of the steps.
    jump : Jump or None
        The jump in the last step.
    """

    def __init__(
        self,
        problem: Problem,
        snes: PETSc.SNES,
        steps: int,
        predictor: str,
        probes: Probes | None = None,
        continuation: PoissonContinuation | None = None,
        transient: Transient | None = None,
        bones: BoneRecords | None = None,
        pressures: CellPressures | None = None,
    ) -> None:
        self.problem, self.snes, self.steps, self.probes = problem, snes, steps, probes
        self.continuation, self.transient, self._bones = continuation, transient, bones
        extrapolate = transient.extrapolate if transient else None
        blend = bones.blend() if bones and predictor == "bones" else None
        self.pressures = pressures
        response = pressures.tangent if pressures else None
        self.predictor = solver.Predictor(problem, snes, predictor, extrapolate, blend, response)
        # Without loads a shorter step is the same problem: it is not tried.
        self.size = transient.step_size() if transient else StepSize(steps, problem.depends_on_load)
        one_step = transient is not None and transient.semi_implicit
        self._semi_implicit = solver.SemiImplicit(problem, snes) if one_step else None
        self._jumps = JumpDetector.of(problem, snes, transient is not None)
        self.jump: Jump | None = None
        self.done = False
        self.seconds = self.processor = 0.0
        self._last: dict[str, Any] = {}
        #: Whether memory was exhausted, in which case a shorter step fails as well.
        self._out_of_memory = False

    def __iter__(self) -> Iterator[dict[str, Any]]:
        problem = self.problem
        for target in (k / self.steps for k in range(1, self.steps + 1)):
            while problem.load < target:
                load = problem.load
                to = self.size.end(load, target)
                row = self._attempt(load, to)
                if row["converged"]:
                    self.size.accept(to, target)
                    proceed = True
                else:
                    proceed = self.size.reject(load, to) and not self._out_of_memory
                yield row
                if not proceed:
                    return
        self.done = True

    def is_output(self, row: dict[str, Any]) -> bool:
        """Return whether output is written after a row: each, or each ``output_every`` steps."""
        every = self.transient.time.output_every if self.transient else 1
        number = round(row["load"] * self.steps)
        return every == 1 or (number % every == 0 and row["load"] == number / self.steps)

    def failure_message(self) -> str:
        """Return the load or time at which the steps stopped before the end, and the reason."""
        load = self.problem.load
        at = (
            f"time {load * self.transient.time.duration:.6g}"
            if self.transient
            else f"load {load:.6g}"
        )
        if self._out_of_memory:
            return f"stopped at {at}: {self._last['reason']}"
        return (
            f"stopped at {at}: a step of 1/{self.size.max_divisions} of the nominal "
            f"one still fails ({self._last['reason']})"
        )

    def _attempt(self, load: float, to: float) -> dict[str, Any]:
        """Solve from ``load`` to load ``to`` and return the row; restore the state on failure."""
        problem, start, processor_start = self.problem, perf_counter(), process_time()
        previous, nonfinite = problem.x.copy(), problem.nonfinite
        problem.history.begin_step(problem.split(problem.x)[0])
        if self.transient:
            self.snes.getPythonContext().force_scale = self.transient.begin_step(to)
        if self.pressures:
            self.pressures.begin_step()
        outcome, predicted = self._solve(to)
        nonfinite = problem.nonfinite - nonfinite
        self._out_of_memory = outcome.out_of_memory
        estimate = self._estimate_error(outcome)
        converged, history = outcome.converged, outcome.history
        self.jump = self._jumps.find(load, previous) if converged and self._jumps else None
        if converged:
            self.predictor.accept()
            if self.transient:
                self.transient.end_step()
            problem.history.end_step(problem.split(problem.x)[0])
        else:
            previous.copy(problem.x)
            problem.set_load(load)
            if self.transient:
                self.transient.cancel_step()
        self._last = {
            "load": to,
            "converged": converged,
            "reason": outcome.reason,
            # The tangent predictor assembles a Hessian too, so it counts as an iteration.
            "newton": len(history) + (predicted > 0),
            "clamped": sum(i.filter in ("clamp", "abs") for i in history),
            "linear": predicted + sum(i.linear for i in history),
            "lbfgs": sum(i.lbfgs for i in history),
            "residual": outcome.residual,
            **problem.history.settling(),
            **self._linear_residual(outcome),
            **self._energies(load, to),
            **(self.pressures.row() if self.pressures else {}),
            **estimate,
            **problem.measures(problem.x),
            "nonfinite": nonfinite,
            "seconds": perf_counter() - start,
        }
        if converged and (kinds := self._notes()):
            self._last["notes"] = kinds
        if converged and (reactions := problem.reactions(problem.x)):
            self._last["reactions"] = reactions
        if converged:
            self._last |= problem.history.record(problem.split(problem.x)[0])
        if converged and self.probes:
            self._last["probes"] = self.probes.values()
        if converged and self._bones:
            self._last["bones"] = self._bones.row()
        self.seconds += perf_counter() - start
        self.processor += process_time() - processor_start
        return self._last

    @staticmethod
    def _linear_residual(outcome: solver.Outcome) -> dict[str, float]:
        """Return the relative residual of a linearised step's linear system."""
        found = outcome.linear_residual
        return {} if found is None else {"linear_residual": found}

    def _notes(self) -> list[str]:
        """Return the kinds of notes on the last step."""
        found = {"inverted": self._last["min_J"] <= 0, "jump": self.jump is not None}
        return [kind for kind, noted in found.items() if noted]

    def _energies(self, load: float, to: float) -> dict[str, Any]:
        """Return the row's energy; in time, time and energies."""
        if self.transient:
            tolerance = self.snes.getPythonContext().scaled_tolerance
            return {**self.transient.row(to, load), "tolerance": tolerance}
        problem = self.problem
        return {"energy": problem.energy(problem.x) if problem.has_energy else None}

    def _estimate_error(self, outcome: solver.Outcome) -> dict[str, float]:
        """Return the estimate of a time step's error; one above the tolerance is a failure."""
        tolerance = self.transient.time.tolerance if self.transient else None
        if self.transient is None or tolerance is None or not outcome.converged:
            return {}
        ratio = self.transient.error() / tolerance
        self.size.ratio = ratio
        if not ratio <= 1:
            outcome.converged, outcome.reason = False, "ERROR_ABOVE_TOLERANCE"
        return {"error": ratio * tolerance}

    def _solve(self, to: float) -> tuple[solver.Outcome, int]:
        """Solve at the load ``to``; return the outcome and the predictor's linear iterations."""
        problem = self.problem
        if self._semi_implicit:
            problem.set_load(to)
            with solver.callback_errors():
                outcome = self._semi_implicit.solve()
            return outcome, 0
        outcome = solver.Outcome()
        try:
            predicted = self.predictor.predict(to)
        except NotSettled as error:
            outcome.fail_inner(error)
            return outcome, 0
        if self._jumps:
            self._jumps.begin()
        if self.continuation:
            outcome.history += self.continuation.solve(problem)
        if self.pressures:
            self.pressures.solve()
            outcome.history += self.pressures.history
        solver.solve_until_settled(problem, self.snes, outcome)
        return outcome, predicted
