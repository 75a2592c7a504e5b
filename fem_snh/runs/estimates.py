"""Estimate the errors of a scene's goals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf
from typing import TYPE_CHECKING

from fem_snh.accuracy.curves import curves_of
from fem_snh.accuracy.estimate import (
    EstimateOptions,
    estimate_error,
    estimating,
    values_of,
    without_bounds,
)
from fem_snh.accuracy.goal_errors import Estimate, NoEstimate, NoEstimateOnAnyMesh, with_bounds
from fem_snh.accuracy.path_errors import estimate_on_path, values_on_path
from fem_snh.accuracy.refinement import left_by_uniform
from fem_snh.cache import Stopwatch
from fem_snh.errors import BadInput, Failed
from fem_snh.problem.goals import Goal, names_of
from fem_snh.runs.level_meshes import coarser_scene, is_refined_locally
from fem_snh.runs.progress import Progress
from fem_snh.runs.result import Result
from fem_snh.runs.scene_goals import goal_loads
from fem_snh.runs.scene_replay import scene_path
from fem_snh.runs.setup import Setup

if TYPE_CHECKING:
    from fem_snh.runs.level_runs import Level
    from fem_snh.runs.recorder import Recorder


def estimate_errors(
    setup: Setup,
    goals: Sequence[Goal],
    recorder: Recorder,
    printed: Progress,
    level: Level | None,
    again: Callable[..., Result] | None,
) -> Estimate:
    """Return the errors of goals of a run that is at its end, with their bounds. Collective.

    Parameters
    ----------
    setup : Setup
        The run, at its end.
    goals : sequence of Goal
        The goals.
    recorder : Recorder
        Has the goals along the path and the states in which they are evaluated. If it writes
        fields, the errors of all goals are distributed to the cells; otherwise only if the scene
        names goals or, in a run to an accuracy, if the mesh is refined locally. Else only the
        largest error is distributed.
    printed : Progress
        Prints the cost before the errors are known.
    level : Level or None
        The level of a run to an accuracy, whose levels measure the errors.
    again : callable or None
        Runs another scene, which measures them otherwise; None: nothing does.
    """
    run = _FinishedRun(setup, goals, recorder, printed)
    if again and not level and setup.scene.error == "coarser":
        estimate = run.errors_of_coarser(again)
    else:
        estimate = run.errors()
        if level:
            level.measure(estimate)
        elif again and not estimate.reason:
            run.add_bounds(estimate, again)
    if recorder.history and not level:
        estimate.history = recorder.history
    return estimate


@dataclass(frozen=True)
class _FinishedRun:
    """A run at its end, with the goals whose errors are estimated: see `estimate_errors`.

    All methods are collective.
    """

    setup: Setup
    goals: Sequence[Goal]
    recorder: Recorder
    printed: Progress

    def errors(self, values_alone: bool = False) -> Estimate:
        """Return the goals with their errors, without bounds; or their values alone.

        They are evaluated along the path if their end depends on it, else in their states.
        """
        setup, goals, states = self.setup, self.goals, self.recorder.states
        scene, problem, by_load = setup.scene, setup.problem, {}
        if states is None:
            path, at = scene_path(setup, self.recorder.history), goal_loads(scene, goals)
            if values_alone:
                return values_on_path(problem, path, goals, at)
            found = estimate_on_path(problem, path, goals, self._options, at)
            found.duration = scene.duration
            return found
        if states.reason:
            with estimating(problem, goals) as estimate:
                raise NoEstimateOnAnyMesh(states.reason)
            return estimate
        assert setup.make is not None
        for load, goals_there in states.by_load().items():
            with states.at(load):
                if values_alone:
                    by_load[load] = values_of(problem, goals_there)
                else:
                    by_load[load] = estimate_error(problem, setup.make, goals_there, self._options)
        return Estimate.merged(by_load, names_of(goals))

    @property
    def _options(self) -> EstimateOptions:
        """What the estimate is for."""
        scene, wanted, max_memory = self.setup.scene, self.setup.scene.accuracy, inf
        if wanted and wanted.max_memory is not None and not scene.within:
            max_memory = 1e6 * wanted.max_memory
        local = is_refined_locally(scene) if scene.within else bool(wanted and wanted.goals)
        return EstimateOptions(
            matters=scene.within or EstimateOptions.matters,
            stability=scene.stability,
            locate_all=local or self.recorder.writes_fields,
            max_memory=max_memory,
            mesh=self.setup.mesh,
            announce=self.printed.estimating,
            update=self.setup.snes.getUpdate(),
        )

    def add_bounds(self, estimate: Estimate, again: Callable[..., Result]) -> None:
        """Add the bounds that a run with half the cells, in time half the steps, too, measures."""
        try:
            coarser, dofs = self._run_coarser(
                estimate, partial(again, alone=True), "measures the estimate"
            )
        except NoEstimate as why:
            estimate.left_out.append(without_bounds(str(why)))
            return
        problem, history = self.setup.problem, self.recorder.history
        left = left_by_uniform(dofs, problem.dofs, problem.element.degree, problem.kinematics.dim)
        estimate.goals = with_bounds(estimate.goals, [coarser.goals], left)
        if history and coarser.history:
            estimate.curves = curves_of(estimate, self.goals, history, coarser.history)

    def errors_of_coarser(self, again: Callable[..., Result]) -> Estimate:
        """Return the differences to the corrected goals of a run with half the cells.

        Their bounds are those of that run, which one with a quarter of the cells measures.
        """
        run, history = self.errors(values_alone=True), self.recorder.history
        try:
            coarser, _ = self._run_coarser(run, again, "has the errors")
        except NoEstimate as why:
            run.reason = str(why)
            return run
        goals = {name: goal.known_from(coarser.goals[name]) for name, goal in run.goals.items()}
        curves = {}
        if history:
            for i, name in enumerate(names_of(self.goals)):
                if curve := coarser.curves.get(name):
                    values = {load: float(vector[i]) for load, vector in history.values.items()}
                    curves[name] = curve.seen_from(values)
        return replace(
            coarser, goals=goals, indicators={}, seconds=run.seconds, loads=run.loads,
            duration=self.setup.scene.duration, curves=curves, history=None,
        )  # fmt: skip

    def _run_coarser(
        self, estimate: Estimate, again: Callable[..., Result], purpose: str
    ) -> tuple[Estimate, int]:
        """Return the errors of a run with half the cells, and its unknowns.

        Its seconds are added to those of ``estimate``.

        Raises
        ------
        NoEstimate
            If there is no coarser mesh, or the run on it has no estimate.
        """
        coarser, what = coarser_scene(self.setup.scene.model_copy(update={"error": True}))
        if coarser is None:
            raise NoEstimate(what)
        self.printed.line(f"  a run with {what} {purpose}")
        watch, failed = Stopwatch(), "the steps fail"
        try:
            result = again(coarser)
            if result.estimate and not result.estimate.reason:
                return result.estimate, result.problem.dofs
            failed = result.estimate.reason if result.estimate else failed
        except (BadInput, Failed) as error:
            failed = str(error)
        finally:
            estimate.seconds += watch.seconds
        raise NoEstimate(f"the run with {what} has none: {failed}")
