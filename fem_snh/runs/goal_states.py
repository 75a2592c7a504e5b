"""The states of a run that its goals are of, where that is not the last one."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import NamedTuple

from petsc4py import PETSc

import numpy as np

from fem_snh.accuracy.frequency_goals import FrequencyGoal
from fem_snh.accuracy.goals import Goal, vector_of
from fem_snh.accuracy.no_estimate import depends_on_path
from fem_snh.problem.problem import Problem
from fem_snh.runs.setup import Setup
from fem_snh.scenes import LARGEST, Scene
from fem_snh.tables.amplitudes import loads_return

#: Sizes of a goal that differ by this part, also of its value at the start, are the same: the later
#: state counts.
_SAME = 1e-6
#: How to ask for the errors at a load of which the state is not known.
_INSTEAD = "expected a scene whose tables end at the load that counts"


class _State(NamedTuple):
    """A state of equilibrium.

    Attributes
    ----------
    load : float
        Its load.
    x : PETSc.Vec
        The unknowns.
    """

    load: float
    x: PETSc.Vec


class GoalStates:
    """The states at named loads, and those in which goals are largest. Collective.

    Parameters
    ----------
    setup : Setup
        The run, at its start.
    goals : sequence of Goal
        Its goals.
    resumed : bool
        Whether earlier states of the run are not known.

    Attributes
    ----------
    reason : str
        Why there is no estimate of errors at these loads; "" if there may be one.
    """

    def __init__(self, setup: Setup, goals: Sequence[Goal], resumed: bool) -> None:
        scene, self._problem, self._goals = setup.scene, setup.problem, list(goals)
        named = scene.accuracy.goals if scene.accuracy else []
        default = LARGEST if _returns(scene) else None
        given = {vector_of(goal.name): goal.at for goal in named}
        at = [given.get(vector_of(goal.names[0])) or default for goal in goals]
        #: None: the end, of which no state is kept.
        self._at = [
            None if isinstance(goal, FrequencyGoal) else load
            for goal, load in zip(goals, at, strict=True)
        ]
        self.reason = ""
        if any(self._at) and depends_on_path(self._problem):
            self.reason = "loads return, or goals are at loads before the end, and the state "
            self.reason += f"depends on its path: {_INSTEAD}"
        elif any(self._at) and resumed:
            self.reason = "goals are at loads before the end, whose states a resumed run lacks: "
            self.reason += "expected a run from its start"
        self._functions = [goal.bind(self._problem) for goal in goals] if any(self._at) else []
        self._start = [np.array(function()) for function in self._functions]
        self._sizes = np.zeros(len(goals))
        self._states: list[_State | None] = [None] * len(goals)

    def add_state(self) -> None:
        """Keep the present state for the goals that are of it."""
        problem, state = self._problem, None
        if not any(self._at) or self.reason:
            return
        sizes = [
            float(np.linalg.norm(np.array(function()) - start))
            for function, start in zip(self._functions, self._start, strict=True)
        ]
        sizes = problem.comm.bcast(sizes)  # all ranks keep the same states
        for i, (at, size) in enumerate(zip(self._at, sizes, strict=True)):
            same = _SAME * (self._sizes[i] + float(np.linalg.norm(self._start[i])))
            is_larger = at == LARGEST and size >= self._sizes[i] - same
            if is_larger or at == problem.load:
                self._sizes[i] = max(size, self._sizes[i])
                state = state or _State(problem.load, problem.x.copy())
                self._states[i] = state

    def by_load(self) -> dict[float, list[Goal]]:
        """Return the goals by the load that they are of."""
        found: dict[float, list[Goal]] = {}
        for goal, state in zip(self._goals, self._states, strict=True):
            found.setdefault(state.load if state else self._problem.load, []).append(goal)
        return found

    @contextmanager
    def at(self, load: float) -> Iterator[None]:
        """Give the problem the state at a load, and then that of the end again."""
        problem = self._problem
        end = _State(problem.load, problem.x.copy())
        kept = [state for state in self._states if state and state.load == load]
        try:
            _restore(problem, kept[0] if kept else end)
            yield
        finally:
            _restore(problem, end)


def _restore(problem: Problem, state: _State) -> None:
    """Give a problem a state. Collective."""
    if state.load == problem.load:
        return
    problem.set_load(state.load)
    state.x.copy(problem.x)
    problem.history.begin_step(problem.split(problem.x)[0])


def _returns(scene: Scene) -> bool:
    """Return whether loads or motions of a static scene may be larger before its end."""
    if scene.time:
        return False
    solids = [*scene.bone, *scene.obstacle]
    if any(getattr(solid, "motion", None) is not None for solid in solids):
        return True
    return loads_return(dict(scene), scene.amplitudes, scene.steps)
