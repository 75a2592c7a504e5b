"""Load stepping from 0 to 1: sizes of the steps, halving of failed ones, and their rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from petsc4py import PETSc

from fem_snh.accuracy.state_notes import unseen_penetrations
from fem_snh.compile_clock import Stopwatch
from fem_snh.problem.probes import Probes
from fem_snh.solver import EquilibriumStability, StepOutcome
from fem_snh.solver.definiteness import negative_eigenvalues
from fem_snh.steps.jump import BEYOND_LIMIT, Finding, JumpDetector
from fem_snh.steps.step_size import StepSize
from fem_snh.steps.step_solver import StepSolver

if TYPE_CHECKING:
    from fem_snh.problem.bone_records import BoneRecords

#: The reason of a step whose end has inverted points and its start none: its halves decide.
INVERTED_END = "INVERTED_END"


class Stepper:
    """An iterator over the attempted load increments; it yields a row of run.json for each.

    The first increment starts from the problem's load. Every multiple of 1/steps is reached. A
    step that fails is rolled back and halved; after a step that converges the size doubles. So is,
    without inertia, a step that inverts points, once: its halves may invert none.

    Parameters
    ----------
    solver : StepSolver
        Solves one step.
    steps : int
        Number of nominal load steps.
    probes : Probes, optional
        Points whose displacement is added to each row.
    bones : BoneRecords, optional
        Bones whose forces are added to each row.
    output_every : int, optional
        Number of nominal steps after which `is_output` is true.
    stability : EquilibriumStability, optional
        Tells of each step whether its equilibrium is stable.
    find_jumps : bool, optional
        Whether steps are examined for jumps, where they can be.

    Attributes
    ----------
    size : StepSize
        The size of the next step.
    targets : sequence of float
        The loads that are reached; the multiples of 1/steps, unless they are set.
    done : bool
        Whether the last of them is reached.
    taken : int
        The steps that converged: more than the nominal ones where some were halved.
    seconds : float
        Elapsed seconds of the steps, without compilation.
    processor : float
        This rank's processor seconds of the steps, without compilation.
    jump : Finding or None
        The jump in the last step.
    """

    def __init__(
        self,
        solver: StepSolver,
        steps: int,
        probes: Probes | None = None,
        bones: BoneRecords | None = None,
        output_every: int = 1,
        stability: EquilibriumStability | None = None,
        find_jumps: bool = True,
    ) -> None:
        self.solver, self.problem, self.steps = solver, solver.problem, steps
        self.targets: Sequence[float] = [k / steps for k in range(1, steps + 1)]
        self._stability = stability
        self.probes, self._bones, self._output_every = probes, bones, output_every
        self.motion = motion = solver.motion
        # Without loads a shorter step is the same problem: it is not tried.
        divisible = self.problem.depends_on_load
        self.size = motion.step_size(steps) if motion else StepSize(steps, divisible)
        examined = find_jumps and not motion
        self._jumps = JumpDetector.of(self.problem, solver.snes) if examined else None
        solver.guessed = self._jumps.begin if self._jumps else None
        self.jump: Finding | None = None
        self._last_jump: Finding | None = None
        self.done, self.taken = False, 0
        self.seconds = self.processor = 0.0
        self._last: dict[str, Any] = {}
        #: The end of the last step that inverted points: up to it ends are not doubted again.
        self._doubted = -1.0
        #: Whether memory was exhausted, in which case a shorter step fails as well.
        self._out_of_memory = False

    def __iter__(self) -> Iterator[dict[str, Any]]:
        problem = self.problem
        for target in self.targets:
            while problem.load < target:
                load = problem.load
                to = self.size.end(load, target)
                row = self.attempt(load, to)
                if row["converged"]:
                    self.size.accept(to, target)
                    self.taken += 1
                    proceed = True
                else:
                    proceed = self.size.reject(load, to) and not self._out_of_memory
                yield row
                if not proceed:
                    return
        self.done = True

    def is_output(self, row: dict[str, Any]) -> bool:
        """Return whether output is written after a row: each, or each ``output_every`` steps."""
        every, number = self._output_every, round(row["load"] * self.steps)
        return every == 1 or (number % every == 0 and row["load"] == number / self.steps)

    def failure_message(self) -> str:
        """Return the load or time at which the steps stopped before the end, and the reason."""
        load = self.problem.load
        at = f"time {load * self.motion.duration:.6g}" if self.motion else f"load {load:.6g}"
        if self._out_of_memory:
            return f"stopped at {at}: {self._last['reason']}"
        return (
            f"stopped at {at}: a step of 1/{self.size.max_divisions} of the nominal "
            f"one still fails ({self._last['reason']}){self._limit_load()}"
        )

    def _limit_load(self) -> str:
        """Return that the body has passed a limit load before the last step failed, or nothing."""
        if (jump := self._last_jump) is None:
            return ""
        between = f"between the loads {jump.start:.6g} and {jump.end:.6g}"
        return f"; the body jumped {between}, which may be a limit load: {BEYOND_LIMIT}"

    def attempt(
        self, load: float, to: float, *, predict: bool = True, restore: bool = True
    ) -> dict[str, Any]:
        """Solve from ``load`` to load ``to`` and return the row: see `StepSolver.solve`."""
        problem, watch = self.problem, Stopwatch()
        nonfinite, estimate = problem.nonfinite, dict[str, float]()
        before = problem.x.copy()
        outcome = self.solver.solve(
            to,
            lambda outcome: estimate.update(self._judge(outcome, before, to)),
            predict=predict,
            restore=restore,
        )
        nonfinite = problem.nonfinite - nonfinite
        self._out_of_memory = outcome.out_of_memory
        converged, history = outcome.converged, outcome.history
        self.jump = None
        if converged and self._jumps:
            self.jump = self._jumps.find(load, before, outcome.newton)
            self._last_jump = self.jump or self._last_jump
        self._last = {
            "load": to,
            "converged": converged,
            "reason": outcome.reason,
            "newton": outcome.newton,
            "clamped": sum(i.filter in ("clamp", "abs") for i in history),
            "linear": outcome.linear,
            "lbfgs": outcome.lbfgs,
            "residual": outcome.residual,
            "tolerance": self._tolerance(outcome),
            **problem.history.settling(),
            **self._linear_residual(outcome),
            **self._stabilisation(outcome),
            **self._energies(load, to),
            **(self.solver.pressures.row() if self.solver.pressures else {}),
            **(self._jumps.row() if converged and self._jumps else {}),
            **estimate,
            **problem.measures(problem.x),
            "nonfinite": nonfinite,
            "seconds": watch.seconds,
        }
        if converged:
            self._last |= self._equilibrium(outcome)
        recorded = problem.history.record(problem.split(problem.x)[0]) if converged else {}
        if converged and (kinds := self._notes(recorded)):
            self._last["notes"] = kinds
        if converged:
            self._last |= problem.reaction_sums(problem.x)
            if rigid := problem.rigid_states(problem.x):
                self._last["rigid"] = rigid
        self._last |= recorded
        if converged and self.probes:
            self._last["probes"] = self.probes.values()
        if converged and self._bones:
            self._last["bones"] = self._bones.row()
        self.seconds += watch.seconds
        self.processor += watch.processor
        return self._last

    def examine_stability(self) -> dict[str, Any]:
        """Return whether the state is stable, if that is requested. Collective."""
        return self._equilibrium(StepOutcome()) if self._stability else {}

    def _equilibrium(self, outcome: StepOutcome) -> dict[str, Any]:
        """Return whether the equilibrium is stable, where that is requested, or where it is not.

        Iterations with an unknown pressure keep the symmetry of a body that has buckled, and no
        globalization leaves it: the last state is always examined.
        """
        problem, snes, negative = self.problem, self.solver.snes, outcome.negative
        if self._stability:
            negative = self._stability.negative_eigenvalues(problem.x)
        elif negative is None and problem.saddle_point and problem.load >= self.targets[-1]:
            if snes.getPythonContext().stability:
                negative = negative_eigenvalues(problem, snes.getKSP())
        if negative is None or not (negative or self._stability):
            return {}
        stable = "stable" if negative == 0 else "unstable equilibrium"
        return {"stability": stable, "negative_eigenvalues": negative}

    def _tolerance(self, outcome: StepOutcome) -> float:
        """Return the norm of the residual [N] at which the step converges."""
        if outcome.tolerance is not None:
            return outcome.tolerance
        return float(self.solver.snes.getPythonContext().scaled_tolerance)

    @staticmethod
    def _linear_residual(outcome: StepOutcome) -> dict[str, float]:
        """Return the relative residual of a linearised step's linear system."""
        residual = outcome.linear_residual
        return {} if residual is None else {"linear_residual": residual}

    @staticmethod
    def _stabilisation(outcome: StepOutcome) -> dict[str, float]:
        """Return the part of a proximal term in the forces of a step that has needed it."""
        part = outcome.stabilisation
        return {} if part is None or not outcome.converged else {"stabilisation": part}

    def _notes(self, recorded: Mapping[str, Any]) -> list[str]:
        """Return the kinds of notes on the last step, of which the terms have recorded this."""
        kinds = {
            "inverted": self._last["min_J"] <= 0,
            "jump": self.jump is not None,
            "unstable": self._last.get("negative_eigenvalues", 0) > 0,
            "penetration": bool(unseen_penetrations(recorded)),
            "stabilised": "stabilisation" in self._last,
        }
        return [kind for kind, noted in kinds.items() if noted]

    def _energies(self, load: float, to: float) -> dict[str, Any]:
        """Return the row's energy; in time, time and energies."""
        if self.motion:
            return self.motion.row(to, load)
        problem = self.problem
        return {"energy": problem.energy(problem.x) if problem.has_energy else None}

    def _judge(self, outcome: StepOutcome, start: PETSc.Vec, to: float) -> dict[str, float]:
        """Make a step a failure that is not believed; return the estimate of a time step's error.

        An error above the tolerance is not believed, nor an end that the halves may not have.
        """
        motion = self.motion
        if motion is None:
            self._doubt_inversion(outcome, start, to)
            return {}
        if motion.tolerance is None:
            return {}
        ratio = motion.error() / motion.tolerance
        self.size.ratio = ratio
        if not ratio <= 1:
            outcome.converged, outcome.reason = False, "ERROR_ABOVE_TOLERANCE"
        return {"error": ratio * motion.tolerance}

    def _doubt_inversion(self, outcome: StepOutcome, start: PETSc.Vec, to: float) -> None:
        """Make a step to a load a failure whose end is the first one with inverted points."""
        problem = self.problem
        if to <= self._doubted or not self.size.is_divisible:
            return
        if not (lowest := problem.measures(problem.x)["min_J"]) <= 0:
            return
        if problem.measures(start)["min_J"] > 0:
            self._doubted, outcome.converged = to, False
            outcome.reason = f"{INVERTED_END}: min J = {lowest:.2g}, at the start > 0"
