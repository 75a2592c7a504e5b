"""Load stepping from 0 to 1: prediction, solution, rollback and halving of failed steps."""

from __future__ import annotations

from collections.abc import Iterator
from time import perf_counter, process_time
from typing import Any

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.fem.probes import Probes
from fem_snh.fem.problem import Problem
from fem_snh.fem.terms.cavity import fluid_states
from fem_snh.runs.poisson_continuation import PoissonContinuation

#: A failed step is halved at most this many times: 1/64 of a nominal step.
_MAX_HALVINGS = 6
#: Relative difference from which two step sizes differ; rounding of the load is smaller.
_ROUNDING = 1e-12


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

    Attributes
    ----------
    size : float or None
        Size of the next step; None if it ends at the next multiple of 1/steps.
    done : bool
        Whether load 1 is reached.
    seconds : float
        Elapsed seconds of the steps.
    processor : float
        This rank's processor seconds of the steps.
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
        # Without loads a shorter step is the same problem: it is not tried.
        self._max_divisions = 2**_MAX_HALVINGS if problem.depends_on_load else 1
        self.done = False
        self.seconds = self.processor = 0.0
        self._last: dict[str, Any] = {}

    def __iter__(self) -> Iterator[dict[str, Any]]:
        problem, shortest = self.problem, 1 / (self._max_divisions * self.steps)
        for target in (k / self.steps for k in range(1, self.steps + 1)):
            while problem.load < target:
                load = problem.load
                size = self.size or target - load
                # A sum of halved steps differs from the target by rounding.
                to = target if size >= (target - load) * (1 - _ROUNDING) else load + size
                row = self._attempt(load, to)
                if row["converged"]:
                    self.size = None if to == target else 2 * size
                else:
                    self.size = (to - load) / 2
                yield row
                if not row["converged"] and (size <= shortest * 1.5 or self._out_of_memory):
                    return
        self.done = True

    def failure_message(self) -> str:
        """Return the load at which the steps stopped before load 1, and the reason."""
        stopped = f"stopped at load {self.problem.load:.6g}"
        if self._out_of_memory:
            return f"{stopped}: {self._last['reason']}"
        return (
            f"{stopped}: a step of 1/{self._max_divisions} of the nominal "
            f"one still fails ({self._last['reason']})"
        )

    @property
    def _out_of_memory(self) -> bool:
        """Whether memory was exhausted, in which case a shorter step fails as well."""
        return solver.out_of_memory(self.snes)

    def _attempt(self, load: float, to: float) -> dict[str, Any]:
        """Solve from ``load`` to load ``to`` and return the row; restore the state on failure."""
        problem, start, processor_start = self.problem, perf_counter(), process_time()
        previous, nonfinite = problem.x.copy(), problem.nonfinite
        predicted = self.predictor.predict(to)
        history = self.continuation.solve(problem) if self.continuation else []
        with solver.callback_errors():
            self.snes.solve(None, problem.x)
        converged = self.snes.getConvergedReason() > 0
        history = [*history, *self.snes.getPythonContext().history]
        residual, reason = self.snes.getFunctionNorm(), solver.failure_reason(self.snes)
        nonfinite = problem.nonfinite - nonfinite
        if converged:
            self.predictor.accept()
        else:
            previous.copy(problem.x)
            problem.set_load(load)
        self._last = {
            "load": to,
            "converged": converged,
            "reason": reason,
            # The tangent predictor assembles a Hessian too, so it counts as an iteration.
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
        if converged and (fluids := fluid_states(problem.terms, problem.x)):
            self._last["cavities"] = fluids
        if converged and self.probes:
            self._last["probes"] = self.probes.values()
        self.seconds += perf_counter() - start
        self.processor += process_time() - processor_start
        return self._last
