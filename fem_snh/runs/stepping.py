"""The load from 0 to 1: prediction, solution, halving, rollback."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter, process_time
from typing import Any

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.fem.probes import Probes
from fem_snh.fem.problem import Problem
from fem_snh.runs.poisson_continuation import PoissonContinuation

#: A step is halved at most this many times.
_HALVINGS = 6


class Stepper:
    """Iterates over attempted load increments, yielding a row of run.json for each.

    Every multiple of 1/steps is reached. A step that fails is rolled back and halved; after a
    success the next one doubles again. It begins at the problem's load.

    Attributes
    ----------
    size : of the next step; None if it goes all the way to the next multiple.
    seconds : what the steps took; ``processor`` what this rank's processor worked for them.
    """

    def __init__(
        self,
        problem: Problem,
        snes: PETSc.SNES,
        steps: int,
        predictor: str,
        probes: Probes | None = None,
        continuation: PoissonContinuation | None = None,
    ) -> None:
        self.problem, self.snes, self.steps, self.probes = problem, snes, steps, probes
        self.continuation = continuation
        self.predictor = solver.Predictor(problem, snes, predictor)
        self.size: float | None = None
        #: Half a load is the same problem again where nothing is loaded.
        self.parts = 2**_HALVINGS if problem.depends_on_load else 1
        self.done = False
        self.seconds = self.processor = 0.0
        self._last: dict[str, Any] = {}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        problem, shortest = self.problem, 1 / (self.parts * self.steps)
        for target in (k / self.steps for k in range(1, self.steps + 1)):
            while problem.load < target:
                load = problem.load
                size = self.size or target - load
                # The last part of a halved step must end at the target to the last digit.
                to = target if size >= (target - load) * (1 - 1e-12) else load + size
                row = self._attempt(load, to)
                if row["converged"]:
                    self.size = None if to == target else 2 * size
                else:
                    self.size = (to - load) / 2
                yield row
                if not row["converged"] and (size <= shortest * 1.5 or self._hopeless):
                    return
        self.done = True

    def failure(self) -> str:
        """Why it ended before load 1."""
        where = f"stopped at load {self.problem.load:.6g}"
        if self._hopeless:
            return f"{where}: {self._last['reason']}"
        return (
            f"{where}: a step of 1/{self.parts} of the nominal "
            f"one still fails ({self._last['reason']})"
        )

    @property
    def _hopeless(self) -> bool:
        """Whether a shorter step will fail as well."""
        return solver.out_of_memory(self.snes)

    def _attempt(self, load: float, to: float) -> dict[str, Any]:
        """Solve at load ``to``, from ``load``; on failure the state is as it was before."""
        problem, start, working = self.problem, perf_counter(), process_time()
        kept, nonfinite = problem.x.copy(), problem.nonfinite
        predicted = self.predictor.predict(to)
        history = self.continuation.solve(problem) if self.continuation else []
        with solver.callback_errors():
            self.snes.solve(None, problem.x)
        converged = self.snes.getConvergedReason() > 0
        history = [*history, *self.snes.getPythonContext().history]
        residual, why = self.snes.getFunctionNorm(), solver.failure_reason(self.snes)
        nonfinite = problem.nonfinite - nonfinite
        if converged:
            self.predictor.accept()
        else:
            kept.copy(problem.x)
            problem.set_load(load)
        self._last = {
            "load": to,
            "converged": converged,
            "reason": why,
            # the tangent predictor is a linear solve with a Hessian of its own
            "newton": len(history) + (predicted > 0),
            "clamped": sum(i.filter in ("clamp", "abs") for i in history),
            "linear": predicted + sum(i.linear for i in history),
            "lbfgs": sum(i.lbfgs for i in history),
            "residual": residual,
            "energy": problem.energy(problem.x) if problem.has_energy else None,
            **problem.measures(problem.x),
            "nonfinite": nonfinite,
            "seconds": perf_counter() - start,
        }
        if converged and (reactions := problem.reactions(problem.x)):
            self._last["reactions"] = reactions
        if converged and self.probes:
            self._last["probes"] = self.probes.values()
        self.seconds += perf_counter() - start
        self.processor += process_time() - working
        return self._last
