"""The goals of a scene, from the names of its table ``[accuracy]``, and their states."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import isclose
from typing import Any, NamedTuple

from petsc4py import PETSc

import numpy as np

from fem_snh import _dolfinx
from fem_snh.arrays import Array
from fem_snh.assembly.boundary_conditions import group_forces
from fem_snh.assembly.kinematics import kinematics_of
from fem_snh.assembly.regions import boundary_facets, owned_cells
from fem_snh.choices import LARGEST, LOAD_DIGITS
from fem_snh.errors import BadInput, bad_value
from fem_snh.mesh.mesh import DIMENSIONS, Mesh
from fem_snh.problem.goals import (
    EnergyGoal,
    Goal,
    MeanGoal,
    PointGoal,
    PointStressGoal,
    ReactionGoal,
    RigidGoal,
    StressGoal,
    TermGoal,
    VolumeGoal,
    is_as_far,
    vector_of,
)
from fem_snh.problem.problem import Problem
from fem_snh.problem.reactions import is_free
from fem_snh.runs.setup import Setup
from fem_snh.scenes import GoalName, Scene, read_goal, term_goals
from fem_snh.tables.amplitudes import loads_return

#: Key of the goals' names.
_KEY = "accuracy.goals"
#: The point of the moment of a group that the scene does not name in ``reactions``.
_ORIGIN = (0.0, 0.0, 0.0)
#: Quadrature degree of means: exact for a displacement of degree 3 on cells with flat faces.
_MEAN_DEGREE = 5


def scene_goals(setup: Setup) -> list[Goal]:
    """Return the goals that a scene names, or else those of `default_goals`. Collective.

    Components of one vector are one goal. Default goals that are forces on free nodes are left out.

    Parameters
    ----------
    setup : Setup
        The scene with its problem.

    Raises
    ------
    BadInput
        On every rank, for a named goal that the scene or its mesh does not have.
    """
    scene = setup.scene
    named = scene.accuracy.names if scene.accuracy else []
    # In a dynamic scene the energy is another sum.
    has_energy = setup.problem.has_energy and scene.time is None
    groups = [*(bone.group for bone in scene.bone), *(part.group for part in scene.rigid)]
    names = named or default_goals(scene, has_energy and None not in groups)
    if "energy" in names and not has_energy:
        why = "in time" if scene.time else "as a load or a material has no energy"
        raise bad_value(_KEY, "energy", f"another goal, {why}")
    # Components of one vector are one goal: their errors are relative to the largest of them.
    vectors: dict[tuple[str, str], tuple[str, GoalName]] = {}
    for name in names:
        read = read_goal(name, scene)
        if free := _on_free_nodes(setup, name, read):
            if named:
                raise free
            continue
        first, before = vectors.get((read.kind, read.name), (name, read))
        components = sorted({*before.components, *read.components})
        vectors[read.kind, read.name] = first, read._replace(components=tuple(components))
    return [_whole_goal(scene, setup.mesh, name, read) for name, read in vectors.values()]


def _whole_goal(scene: Scene, mesh: Mesh, text: str, read: GoalName) -> Goal:
    """Return a goal with all components of its vector, as an estimate of one is small by chance.

    Sums of radial forces of a body of revolution are no component of a vector.
    """
    goal, revolved = _goal(scene, mesh, text, read), kinematics_of(scene.kinematics).revolved
    if not read.components or (revolved and goal.is_force):
        return goal
    whole = _goal(scene, mesh, text, read_goal(vector_of(goal.names[0]), scene))
    whole.unasked = set(whole.names) - set(goal.names)
    return whole


def named_goals(setup: Setup, names: Sequence[str]) -> list[Goal]:
    """Return goals of one component by their names.

    Raises
    ------
    BadInput
        On every rank, for a goal that the scene or its mesh does not have, for the energy, and for
        a vector.
    """
    goals = []
    for name in names:
        read = read_goal(name, setup.scene)
        if free := _on_free_nodes(setup, name, read):
            raise free
        goal = _goal(setup.scene, setup.mesh, name, read)
        if name == "energy" or len(goal.names) > 1:
            raise bad_value("goal", name, "a component such as right.force.x, or a volume")
        goals.append(goal)
    return goals


def _on_free_nodes(setup: Setup, text: str, read: GoalName) -> BadInput | None:
    """Return an exception if a goal is the force or moment of free nodes, else None. Collective.

    Such a force is the residual, whose error is unknown.
    """
    if read.kind not in ("force", "moment") or not is_free(setup.problem, setup.mesh, read.name):
        return None
    accepted = "a group with constrained nodes: on free ones the force is zero, up to the residual"
    return bad_value("goal", text, accepted)


def default_goals(scene: Scene, has_energy: bool) -> list[str]:
    """Return the names of the goals of a scene that names none.

    They are the scene's probes, reactions, results of features, volumes and energy. On a body of
    revolution only the axial component of a force or displacement is a goal: the sum of the radial
    forces acts on no other body, and converges slowly at the corners of bonded rubber.
    """
    turned = [reaction for reaction in scene.reactions if reaction.about]
    kinematics = kinematics_of(scene.kinematics)
    force = "force.y" if kinematics.revolved else "force"
    # In a dynamic scene a contact that opens and closes may have any force at the end.
    results = [] if scene.time else term_goals(scene.features)
    for part in scene.rigid:
        unknown = part.unknown_results[: 2 if kinematics.moment_axes else 1]
        results += [f"{part.label}.{result}" for result in unknown]
    if kinematics.revolved:
        along = (".force", ".displacement")
        results = [f"{name}.y" if name.endswith(along) else name for name in results]
    return [
        *(probe.name for probe in scene.probe),
        *(f"{reaction.group}.{force}" for reaction in scene.reactions),
        *results,
        *(f"{reaction.group}.moment" for reaction in turned if kinematics.moment_axes),
        *(f"{group}.volume" for group in scene.volumes),
        "volume",
        *(["energy"] if has_energy else []),
    ]


def _goal(scene: Scene, mesh: Mesh, text: str, read: GoalName) -> Goal:
    """Return the goal that ``read`` describes; ``text`` is its name in messages."""
    kind, name, components = read
    if kind == "energy":
        return EnergyGoal()
    if kind == "term":
        return TermGoal(name, components)
    if kind == "rigid":
        part, _, result = name.rpartition(".")
        if result not in ("force", "moment") or part not in [str(r.group) for r in scene.reactions]:
            return RigidGoal(part, result, components)
        kind, name = result, part  # about the point that ``reactions`` names
    if kind in ("point", "stress_at"):
        probe = next(probe for probe in scene.probe if probe.name == name)
        if kind == "point":
            return PointGoal(name, probe.point, components)
        assert probe.radius is not None
        return PointStressGoal(text, probe.point, probe.radius, mesh.domain)
    if kind in ("volume", "stress"):
        of_cells = VolumeGoal if kind == "volume" else StressGoal
        return of_cells(text, _cells(mesh, name, text) if name else None)
    if kind == "mean":
        return MeanGoal(f"{name}.mean", _measure(mesh, name, text), components)

    def weigh(problem: Problem) -> Array:
        return np.asarray(group_forces(problem.V, mesh, name, problem.dirichlet).weights)

    named = [r.about for r in scene.reactions if str(r.group) == name and r.about]
    about = [*named, _ORIGIN][0] if kind == "moment" else None
    return ReactionGoal(f"{name}.{kind}", weigh, components, about)


def _cells(mesh: Mesh, key: str, text: str) -> Any:
    """Return the owned cells of a group of cells; raise BadInput for another group."""
    group = mesh.group(key)
    if group.dim != mesh.dim:
        cells = DIMENSIONS[mesh.dim]
        raise bad_value(_KEY, text, f"a goal of a group of {cells}s, not of a {group.label}")
    return owned_cells(mesh, _KEY, key)


def _measure(mesh: Mesh, key: str, text: str) -> Any:
    """Return the UFL measure of a group of facets or cells."""
    if mesh.group(key).dim == mesh.dim - 1:
        return _dolfinx.surface_measure(mesh.domain, boundary_facets(mesh, _KEY, key))
    cells = _cells(mesh, key, text)
    others = np.setdiff1d(np.arange(_dolfinx.num_owned(mesh.domain), dtype=np.int32), cells)
    measures = _dolfinx.cell_measures(mesh.domain, [cells, others], mesh.cell, _MEAN_DEGREE)
    return measures[0]


def goal_loads(scene: Scene, goals: Sequence[Goal]) -> dict[Goal, float | str]:
    """Return the load, or `LARGEST`, of each goal that is not evaluated in the last state."""
    named = scene.accuracy.goals if scene.accuracy else []
    given = {vector_of(goal.name): goal.at for goal in named}
    default = LARGEST if _returns(scene) else None
    loads = {goal: given.get(vector_of(goal.names[0])) or default for goal in goals}
    end = scene.duration or 1.0
    return {g: at / end if isinstance(at, float) else at for g, at in loads.items() if at}


class _State(NamedTuple):
    """A state of equilibrium.

    Attributes
    ----------
    load : float
        The state's load.
    x : PETSc.Vec
        The unknowns.
    """

    load: float
    x: PETSc.Vec


class GoalStates:
    """The states in which goals are evaluated that do not depend on the path. Collective.

    A goal is evaluated at a named load, at the load where it is largest, or at the end.

    Parameters
    ----------
    setup : Setup
        The run, at its start.
    goals : sequence of Goal
        The run's goals.
    resumed : bool
        Whether the run was resumed, so that earlier states are not known.

    Attributes
    ----------
    reason : str
        Why errors in these states cannot be estimated; "" if they may be.
    """

    def __init__(self, setup: Setup, goals: Sequence[Goal], resumed: bool) -> None:
        self._problem, self._goals = setup.problem, list(goals)
        #: The load, or `LARGEST`, of each goal that is not evaluated in the last state.
        self._at = goal_loads(setup.scene, goals)
        self.reason = ""
        if self._at and resumed:
            self.reason = "goals are at loads before the end, whose states a resumed run lacks: "
            self.reason += "expected a run from its start"
        self._functions = {goal: goal.bind(self._problem) for goal in self._at}
        self._start = {goal: np.array(values()) for goal, values in self._functions.items()}
        self._sizes = dict.fromkeys(self._at, 0.0)
        self._states: dict[Goal, _State] = {}

    def add(self) -> None:
        """Keep the present state for goals at its load, and for goals that are largest so far."""
        problem, state = self._problem, None
        if self.reason:
            return
        for goal, at in self._at.items():
            start, largest = self._start[goal], self._sizes[goal]
            size = float(np.linalg.norm(np.array(self._functions[goal]()) - start))
            size = problem.comm.bcast(size)  # all ranks keep the same states
            if at == LARGEST:
                is_there = is_as_far(size, largest, float(np.linalg.norm(start)))
            else:
                is_there = isclose(float(at), problem.load, abs_tol=10**-LOAD_DIGITS)
            if is_there:
                state = state or _State(problem.load, problem.x.copy())
                self._sizes[goal], self._states[goal] = max(size, largest), state

    def by_load(self) -> dict[float, list[Goal]]:
        """Return the goals by the load of the state in which they are evaluated."""
        found: dict[float, list[Goal]] = {}
        for goal in self._goals:
            state = self._states.get(goal)
            found.setdefault(state.load if state else self._problem.load, []).append(goal)
        return found

    @contextmanager
    def at(self, load: float) -> Iterator[None]:
        """Set the problem to the state at a load for a ``with`` block, then to the last state."""
        problem = self._problem
        end = _State(problem.load, problem.x.copy())
        kept = [state for state in self._states.values() if state.load == load]
        try:
            _restore(problem, kept[0] if kept else end)
            yield
        finally:
            _restore(problem, end)


def _restore(problem: Problem, state: _State) -> None:
    """Set a problem to a state, unless it is at this load. Collective."""
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
