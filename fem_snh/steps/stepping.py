"""Load and time steps of scenes and programs: solution, sizes, halving, rows of run.json."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from math import ceil
from typing import TYPE_CHECKING, Any, cast

from petsc4py import PETSc

from fem_snh import solver
from fem_snh.cache import Stopwatch
from fem_snh.choices import DEFAULT_PREDICTOR
from fem_snh.errors import NotSettled
from fem_snh.problem.probes import Probes
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import has_settled, unseen_penetrations
from fem_snh.solver import EquilibriumStability, StepOutcome
from fem_snh.solver.linear_choice import MAX_NODES
from fem_snh.solver.stability import negative_eigenvalues
from fem_snh.steps.cell_pressures import CellPressures
from fem_snh.steps.jump_detection import BEYOND_LIMIT, Finding, JumpDetector

if TYPE_CHECKING:
    from fem_snh.problem.bones import BoneRecords
    from fem_snh.steps.dynamics.dynamics import Dynamics
    from fem_snh.steps.poisson_continuation import PoissonContinuation
    from fem_snh.steps.rescue import Rescue


class StepSolver:
    """Solve a step: predict, solve until nothing lagged changes, accept or restore the start.

    `Stepper`, `fem_snh.nonlinear_problem.NonlinearProblem` and
    `fem_snh.dynamic_problem.DynamicProblem` make their steps by it.

    Parameters
    ----------
    problem : Problem
        The discretised problem.
    snes : PETSc.SNES
        The problem's nonlinear solver.
    predictor : str, optional
        First guess of a step: see `fem_snh.solver.Predictor`.
    continuation : PoissonContinuation, optional
        Improves the first guess by solves with other Poisson's ratios.
    pressures : CellPressures, optional
        Solves each step with the cell pressures as unknowns first.
    blend : callable, optional
        Moves all nodes with the bones: see `fem_snh.solver.Predictor`.

    Attributes
    ----------
    predictor : Predictor
        The predictor, which keeps the equilibrium before the present one.
    guessed : callable or None
        A function without arguments, called when ``problem.x`` is the first guess of a step.
    """

    def __init__(
        self,
        problem: Problem,
        snes: PETSc.SNES,
        predictor: str = DEFAULT_PREDICTOR,
        continuation: PoissonContinuation | None = None,
        pressures: CellPressures | None = None,
        blend: Callable[[PETSc.Vec, float, float], None] | None = None,
    ) -> None:
        self.problem, self.snes = problem, snes
        self.motion = motion = cast("Dynamics | None", problem.motion)
        self.guessed: Callable[[], None] | None = None
        self.continuation, self.pressures = continuation, pressures
        extrapolate = motion.extrapolate if motion else None
        response = pressures.tangent if pressures else None
        self.predictor = solver.Predictor(problem, snes, predictor, extrapolate, blend, response)
        self._rescue: Rescue | None = None
        self._rescued = False  # whether the last step was
        self._linearised = motion is not None and motion.integrator.name == "semi_implicit"

    def solve(
        self,
        load: float,
        judge: Callable[[solver.StepOutcome], None] | None = None,
        *,
        predict: bool = True,
        restore: bool = True,
    ) -> solver.StepOutcome:
        """Solve from the problem's state to a load, in place; return the outcome. Collective.

        Parameters
        ----------
        load : float
            The load at the step's end, 0 to 1.
        judge : callable, optional
            ``judge(outcome)`` may turn a step that converged into a failure.
        predict : bool
            Whether the first guess is a prediction; otherwise it is the present state.
        restore : bool
            Whether a failed step restores the load and state of its start; otherwise its last
            iterate stays in ``problem.x``.
        """
        problem, motion = self.problem, self.motion
        start, before, history = problem.x.copy(), problem.load, list[solver.Iteration]()
        for number, rescues in enumerate(self._attempts()):
            if number:
                start.copy(problem.x)
                problem.set_load(before)
            tried = self._attempt(load, predict, rescues)
            history += tried.history
            gave_up = self.snes.getPythonContext().gave_up
            if tried.converged or gave_up or not rescues:
                outcome = tried
            if tried.converged:
                self._rescued = rescues
            if tried.converged or gave_up:
                break
        outcome.history = history
        if judge and outcome.converged:
            judge(outcome)
        if outcome.converged:
            if predict:
                self.predictor.accept()
            if motion:
                motion.end_step(problem)
            problem.history.end_step(problem.split(problem.x)[0])
        elif restore:
            start.copy(problem.x)
            problem.set_load(before)
            if motion:
                motion.cancel_step(problem)
        return outcome

    def _attempt(self, load: float, predict: bool, rescues: bool) -> solver.StepOutcome:
        """Solve from the problem's state to a load, by `Rescue` if ``rescues``."""
        problem, context = self.problem, self.snes.getPythonContext()
        problem.history.begin_step(problem.split(problem.x)[0])
        if self.motion:
            norms = self.motion.begin_step(problem, load)
            context.earlier_force, context.least_load = norms
        if self.pressures:
            self.pressures.begin_step()
        with solver.callback_errors():
            return self._solve(load, predict, rescues)

    @property
    def can_rescue(self) -> bool:
        """Whether failed steps, unless given up, are solved again by `Rescue`: with contact."""
        problem = self.problem
        touches = any(term.is_contact for term in problem.terms) and problem.motion is None
        assembled = problem.is_assembled and bool(problem.regions)
        return touches and assembled and problem.regime.nodes <= MAX_NODES

    def _attempts(self) -> Sequence[bool]:
        """Return for each attempt of a step whether it is by `Rescue`.

        The second attempt is; after a step that `Rescue` solved, the first.
        """
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
        # In motion, forces that are small beside others, as the weight of a body in tension, count.
        self.snes.getPythonContext().force_iteration = self.motion is not None
        judge = self._fail_sliding_step if self.can_rescue and not self._rescued else None
        solver.solve_until_settled(problem, self.snes, outcome, judge)
        return outcome

    def _fail_sliding_step(self, outcome: solver.StepOutcome) -> None:
        """Fail a step that followed negative curvature to a state where surfaces slide off.

        That state is a minimum for lagged pairs of points and facets that no longer touch. Further
        solves begin far from the path: they alternate, or their end depends on their order.
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


#: The reason of a step that fails as it inverts points and its start has none.
INVERTED = "INVERTED"


class Stepper:
    """An iterator over the attempted load increments; it yields a row of run.json for each.

    The first increment starts from the problem's load. Every multiple of 1/steps is the end of an
    increment. A failed step is rolled back and halved; after a step that converges the size
    doubles, up to the nominal size. In statics, the first step that inverts points fails, as its
    halves may invert none: at its end, or once filtered Newton steps make little progress.

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
        Counts the negative eigenvalues of each equilibrium.
    find_jumps : bool, optional
        Whether steps of a static problem with loads are examined for jumps.

    Attributes
    ----------
    size : StepSize
        The size of the next step.
    targets : sequence of float
        The loads at which steps end, in ascending order. Default: the multiples of 1/steps.
    doubted : float
        The end of the last step that failed by inverted points: no step up to it fails so again.
    done : bool
        Whether the last target is reached.
    taken : int
        Number of steps that converged, halved steps included.
    seconds : float
        Elapsed seconds of the steps, without compilation.
    processor : float
        This rank's processor seconds of the steps, without compilation.
    jump : Finding or None
        What `JumpDetector.find` found in the last step.
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
        self.size = StepSize(steps, motion is not None or self.problem.depends_on_load)
        if motion and motion.tolerance is not None:
            self.size = AdaptiveStepSize(steps, motion.integrator.order)
        examined = find_jumps and not motion
        self._jumps = JumpDetector.of(self.problem, solver.snes) if examined else None
        solver.guessed = self._jumps.begin if self._jumps else None
        self.jump: Finding | None = None
        self._last_jump: Finding | None = None
        self.done, self.taken = False, 0
        self.seconds = self.processor = 0.0
        self._last: dict[str, Any] = {}
        self.doubted = -1.0
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
        """Return whether output is due: after every row, or each ``output_every`` nominal steps."""
        every, number = self._output_every, round(row["load"] * self.steps)
        return every == 1 or (number % every == 0 and row["load"] == number / self.steps)

    def failure_message(self) -> str:
        """Return the message that steps stopped before the end: load or time, and reason."""
        load = self.problem.load
        at = f"time {load * self.motion.duration:.6g}" if self.motion else f"load {load:.6g}"
        if self._out_of_memory:
            return f"stopped at {at}: {self._last['reason']}"
        return (
            f"stopped at {at}: a step of 1/{self.size.max_divisions} of the nominal "
            f"one still fails ({self._last['reason']}){self._limit_load()}"
        )

    def _limit_load(self) -> str:
        """Return a remark on the last jump, which may be a limit load; "" without a jump."""
        if (jump := self._last_jump) is None:
            return ""
        between = f"between the loads {jump.start:.6g} and {jump.end:.6g}"
        return f"; the body jumped {between}, which may be a limit load: {BEYOND_LIMIT}"

    def attempt(
        self, load: float, to: float, *, predict: bool = True, restore: bool = True
    ) -> dict[str, Any]:
        """Solve from the present ``load`` to ``to``; return the row, and set `jump`. Collective.

        ``predict`` and ``restore`` are those of `StepSolver.solve`.
        """
        problem, watch = self.problem, Stopwatch()
        nonfinite, estimate = problem.nonfinite, dict[str, float]()
        before, context = problem.x.copy(), self.solver.snes.getPythonContext()
        context.give_up = partial(self._inverts, before, to)
        try:
            outcome = self.solver.solve(
                to,
                lambda outcome: estimate.update(self._judge(outcome, before, to)),
                predict=predict,
                restore=restore,
            )
        finally:
            context.give_up = None
        nonfinite = problem.nonfinite - nonfinite
        self._out_of_memory = outcome.out_of_memory
        converged, history = outcome.converged, outcome.history
        self.jump = None
        if converged and self._jumps:
            self.jump = self._jumps.find(load, before, outcome.newton)
            self._last_jump = self.jump or self._last_jump
        tolerance = context.scaled_tolerance if outcome.tolerance is None else outcome.tolerance
        optional = {  # of a linearised step; of a rescued one, proximal over largest force
            "linear_residual": outcome.linear_residual,
            "stabilisation": outcome.stabilisation if converged else None,
        }
        self._last = {
            "load": to,
            "converged": converged,
            "reason": outcome.reason,
            "newton": outcome.newton,
            "clamped": sum(i.filter in ("clamp", "abs") for i in history),
            "linear": outcome.linear,
            "lbfgs": outcome.lbfgs,
            "residual": outcome.residual,
            "tolerance": float(tolerance),
            **problem.history.settling(),
            **{key: value for key, value in optional.items() if value is not None},
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
        """Return the row's entries on the present state's stability, {} if not asked for."""
        return self._equilibrium(StepOutcome()) if self._stability else {}

    def _equilibrium(self, outcome: StepOutcome) -> dict[str, Any]:
        """Return "stability" and "negative_eigenvalues" if asked for or unstable, else {}.

        With an unknown pressure the last state is always examined: Newton's iterations keep the
        symmetry of a body that has buckled, and no globalization leaves it.
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

    def _notes(self, recorded: Mapping[str, Any]) -> list[str]:
        """Return the kinds of notes on the last step; ``recorded``: of `TermHistory.record`."""
        kinds = {
            "inverted": self._last["min_J"] <= 0,
            "jump": self.jump is not None,
            "unstable": self._last.get("negative_eigenvalues", 0) > 0,
            "penetration": bool(unseen_penetrations(recorded)),
            "stabilised": "stabilisation" in self._last,
            "targets": not has_settled(recorded),
        }
        return [kind for kind, noted in kinds.items() if noted]

    def _energies(self, load: float, to: float) -> dict[str, Any]:
        """Return the row's entries of energy; in motion also its times."""
        if self.motion:
            return self.motion.row(self.problem, to, load)
        problem = self.problem
        return {"energy": problem.energy(problem.x) if problem.has_energy else None}

    def _judge(self, outcome: StepOutcome, start: PETSc.Vec, to: float) -> dict[str, float]:
        """Fail a step that inverts points, or whose error exceeds the tolerance of time steps.

        Return {"error": local error} of a time step with a tolerance, else {}.
        """
        motion = self.motion
        if reason := self._inverts(start, to, self.problem.x):
            outcome.converged, outcome.reason = False, reason
        if motion is None or motion.tolerance is None:
            return {}
        ratio = motion.local_error(self.problem) / motion.tolerance
        self.size.ratio = ratio
        if not ratio <= 1:
            outcome.converged, outcome.reason = False, "ERROR_ABOVE_TOLERANCE"
        return {"error": ratio * motion.tolerance}

    def _inverts(self, start: PETSc.Vec, to: float, x: PETSc.Vec) -> str:
        """Return why to halve a static step that inverts points at ``x``, or "". Collective.

        So if its start has no inverted points. The halves are believed: later steps up to the load
        ``to`` may invert points.
        """
        if self.motion or to <= self.doubted or not self.size.is_divisible:
            return ""
        if not (lowest := self.problem.measures(x)["min_J"]) <= 0:
            return ""
        if not self.problem.measures(start)["min_J"] > 0:
            return ""
        self.doubted = to
        return f"{INVERTED}: min J = {lowest:.2g}, at the start > 0"


#: A failed step is halved at most this many times: 1/64 of a nominal step.
MAX_HALVINGS = 6
#: Relative difference from which two step sizes differ; rounding of the load is smaller.
_ROUNDING = 1e-12
#: Bounds of the factor from one adaptive step to the next, and the safety factor (Hairer, Norsett &
#: Wanner 1993, section II.4).
_LEAST, _MOST, _SAFETY = 0.2, 2.0, 0.9


class StepSize:
    """Sizes of load steps, as parts of the whole load.

    After a step that fails the size is halved; after a step that converges it doubles, up to the
    next multiple of 1/steps. `AdaptiveStepSize` follows an error estimate, too.

    Parameters
    ----------
    steps : int
        Number of nominal steps.
    divisible : bool
        Whether a shorter step is tried after a failure.

    Attributes
    ----------
    next : float or None
        Size of the next step; None if it ends at the next multiple of 1/steps.
    ratio : float
        Error of the last step over its tolerance; to be set before `accept` or `reject`.
    max_divisions : int
        Largest number of steps into which a nominal step is divided.
    """

    def __init__(self, steps: int, divisible: bool = True) -> None:
        self.next: float | None = None
        self.ratio = 0.0
        self.max_divisions = 2**MAX_HALVINGS if divisible else 1
        self._shortest = 1 / (self.max_divisions * steps)
        self._size = 0.0

    def end(self, load: float, target: float) -> float:
        """Return the load at the end of the next step from ``load``: at most ``target``."""
        rest = target - load
        self._size = size = self.next or rest
        # A sum of halved steps differs from the target by rounding.
        return target if size >= rest * (1 - _ROUNDING) else load + size

    def accept(self, to: float, target: float) -> None:
        """Set the size of the next step, after one that converged and ended at ``to``."""
        self.next = None if to == target else 2 * self._size

    @property
    def is_divisible(self) -> bool:
        """Whether the halves of the present step may be tried."""
        return self._size > self._shortest * 1.5

    def reject(self, load: float, to: float) -> bool:
        """Halve the size after a failed step; return whether a step so short may be tried."""
        self.next = (to - load) / 2
        return self.is_divisible


class AdaptiveStepSize(StepSize):
    """Sizes of time steps, at most the nominal size, by an estimate of their error.

    Parameters
    ----------
    steps : int
        Number of nominal steps.
    order : int
        Order of accuracy p: a step's error is proportional to the power p + 1 of its size.
    """

    def __init__(self, steps: int, order: int) -> None:
        super().__init__(steps)
        self._order, self._nominal = order, 1 / steps

    def end(self, load: float, target: float) -> float:
        """Return the end of the next step: the rest up to ``target`` is divided evenly."""
        rest = target - load
        parts = ceil(rest / (self.next or rest) * (1 - _ROUNDING))
        self._size = rest / parts
        return target if parts == 1 else load + self._size

    def accept(self, to: float, target: float) -> None:
        """Set the size of the next step by the error of the last one, at most the nominal."""
        factor = self._factor()
        wanted = factor * self._size
        if factor >= 1:  # the step may have been shorter than its error allowed
            wanted = max(wanted, self.next or self._nominal)
        self.next = wanted if wanted < self._nominal * (1 - _ROUNDING) else None

    def reject(self, load: float, to: float) -> bool:
        """Reduce the size after a step that failed; return whether it may be tried."""
        factor = min(0.5, self._factor()) if self.ratio > 1 else 0.5
        self.next = max(self._shortest, factor * self._size)
        return self.is_divisible

    def _factor(self) -> float:
        """Return the factor of the size at which the error would be the tolerance, bounded."""
        if self.ratio == 0:
            return _MOST
        return min(_MOST, max(_LEAST, _SAFETY * self.ratio ** (-1 / (self._order + 1))))


#: Relative change of boundary values up to which it is rounding, as of nodes in inclined planes.
_SAME_VALUES = 1e-14


def boundary_values_changed(problem: Problem) -> bool:
    """Return whether boundary values at load 1 differ from the present unknowns. Collective."""
    prescribed, norm, load = problem.x.copy(), PETSc.NormType.INFINITY, problem.load
    problem.set_load(1.0)
    problem.prescribe(prescribed)
    problem.set_load(load)
    prescribed.axpy(-1.0, problem.x)
    return bool(prescribed.norm(norm) > _SAME_VALUES * problem.x.norm(norm))
