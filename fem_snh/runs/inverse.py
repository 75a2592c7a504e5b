r"""Fit numbers of a scene to a measured curve, such as a force over a displacement.

A goal :math:`Q_k` of the equilibrium at load k has by the adjoint method the derivative

.. math::

    \frac{dQ_k}{dp} = \frac{\partial Q_k}{\partial p} - z_k \cdot \frac{\partial r}{\partial p},
    \qquad H z_k = \frac{\partial Q_k}{\partial u}

with the exact Hessian H, which is symmetric: one linear solve for each measured value, whatever the
number of parameters. The partial derivatives of goals and residual r by a parameter are central
differences at the converged states, without another solve for equilibrium. A reaction is a sum of
residuals: the dual solution includes the partial derivative.

As goals have different units, the residuals of each goal are divided by the goal's largest measured
value, and have a variance of their own in the standard errors.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import numpy.typing as npt
from scipy.optimize import least_squares

from fem_snh import materials, scenes, solver
from fem_snh.arrays import Array
from fem_snh.errors import BadInput, Failed, bad_value, is_number, on_every
from fem_snh.files import write_file
from fem_snh.linalg.direct_solver import set_direct_solver, set_direct_solver_of_sum
from fem_snh.problem.duals import HessianSolver, Linearisation
from fem_snh.problem.goals import Goal, bind_all
from fem_snh.records.run_record import Record
from fem_snh.runs.scene_goals import named_goals
from fem_snh.runs.scene_options import scene_options
from fem_snh.runs.setup import Setup, define_scene, set_up
from fem_snh.studies.fit.data import WITH_A_SQUARE, is_safe_to_square, read_cells
from fem_snh.studies.fit.family import accepted_range
from fem_snh.studies.fit.least_squares import reaches_bound, standard_errors
from fem_snh.studies.fit.result import r_squared, toml_table

Mask = npt.NDArray[np.bool_]

#: Step of the central difference of residuals in a variable of size one: the cube root of the
#: rounding error.
_STEP = 6e-6
#: Relative tolerance of the adjoint solves.
_ADJOINT = 1e-9
#: Loads that differ by less are the same.
_SAME_LOAD = 1e-9
#: Relative change of the sum of squares, and of the parameters, at which the search ends.
_TOLERANCE = 1e-7
#: A run that fails counts as residuals of this many times the measured curve.
_FAILED = 10.0
#: Largest number of runs.
MAX_SOLVES = 12
#: Keys of a scene that are parameters without the prefix "material.".
_SCENE_KEYS = ("E", "nu")
#: Poisson's ratios between which nu is sought, its variable log(1 - 2 nu) being bounded; and the
#: factor by which positive parameters may differ from their first values, either way.
_NU_RANGE, _WIDEST = (-0.9, 0.4999995), 1e3
#: Name of a first column with loads, from 0 to 1; the other name is the scene's ``load_name``.
_LOAD = "load"


@dataclass(frozen=True)
class MeasuredCurve:
    """Measured goals over the load.

    Attributes
    ----------
    label : str
        Name of the first column of the file.
    x : (n,)
        The values of that column.
    loads : (n,)
        The loads, in (0, 1], ascending.
    names : list of str
        The goals.
    values : (n, goals)
        The measurements; NaN where a cell is empty.

    Raises
    ------
    BadInput
        If all measured values of a goal are 0, or the square of one overflows or underflows.
    """

    label: str
    x: Array
    loads: Array
    names: list[str]
    values: Array

    def __post_init__(self) -> None:
        for name, column in zip(self.names, self.values.T, strict=True):
            safe = is_safe_to_square(column[np.isfinite(column)]).all()
            if not safe or not np.nansum(np.abs(column)):
                raise BadInput(
                    f"goal {name}: expected measured values other than 0, {WITH_A_SQUARE}"
                )

    @property
    def known(self) -> Mask:
        """Return a mask of the values that were measured, (n, goals)."""
        return np.isfinite(self.values)

    @property
    def scales(self) -> Array:
        """Return the largest absolute value of each goal, (goals,)."""
        return np.asarray(np.nanmax(np.abs(self.values), axis=0))


@dataclass
class SceneFit:
    """Numbers of a scene fitted to a curve.

    Attributes
    ----------
    parameters : dict
        The fitted numbers by name.
    errors : dict
        Their standard errors; NaN at a bound, infinite if the data do not determine a number.
    curve : MeasuredCurve
        The measurements.
    fitted : (n, goals)
        The goals of the fitted scene; NaN where none was measured.
    converged : bool
        Whether the search converged.
    solves : int
        Runs of the scene.
    linear : int
        Iterations of the adjoint solves.
    material : dict
        The scene's table ``material`` with the fitted numbers.
    """

    parameters: dict[str, float]
    errors: dict[str, float]
    curve: MeasuredCurve
    fitted: Array
    converged: bool
    solves: int
    linear: int
    material: Record

    @property
    def rms(self) -> dict[str, float]:
        """Return the root mean square of the residuals of each goal, in its unit."""
        squares = np.nanmean((self.fitted - self.curve.values) ** 2, axis=0)
        return dict(zip(self.curve.names, map(float, np.sqrt(squares)), strict=True))

    @property
    def r_squared(self) -> dict[str, float]:
        """Return the coefficient of determination R^2 of each goal; NaN for a constant goal."""
        columns = zip(self.curve.values.T, self.fitted.T, self.curve.known.T, strict=True)
        found = [r_squared(v[known], (fitted - v)[known]) for v, fitted, known in columns]
        return dict(zip(self.curve.names, found, strict=True))

    def record(self) -> Record:
        """Return the content of fit.json: JSON values, with None for infinity and NaN."""
        curve = self.curve
        return {
            "parameters": self.parameters,
            "standard_errors": _finite(self.errors),
            "converged": self.converged,
            "solves": self.solves,
            "linear": self.linear,
            "r_squared": _finite(self.r_squared),
            "rms": self.rms,
            "loads": curve.loads.tolist(),
            "measured": _by_name(curve.names, curve.values),
            "fitted": _by_name(curve.names, self.fitted),
        }

    def table(self) -> str:
        """Return the fitted table ``[material]`` of the scene as TOML."""
        return toml_table("material", self.material)

    def write(self, path: str | Path) -> Path:
        """Write `record` as JSON; return the path. Raises BadInput if that fails."""
        return write_file(path, json.dumps(self.record(), indent=1) + "\n")

    def write_table(self, path: str | Path) -> Path:
        """Write `table`; return the path. Raises BadInput if that fails."""
        return write_file(path, self.table())

    def plot(self, path: str | Path) -> Path:
        """Draw measured points and fitted lines of the goals over ``curve.x``; return the path.

        Raises BadInput if the picture cannot be written.
        """
        from fem_snh.viewing.plots.materials import draw_curve

        return draw_curve(self.curve, self.fitted, Path(path))


def _finite(values: dict[str, float]) -> dict[str, float | None]:
    """Return numbers for JSON: None for infinity and NaN."""
    return {name: value if np.isfinite(value) else None for name, value in values.items()}


def _by_name(names: Sequence[str], values: Array) -> dict[str, list[float | None]]:
    rows = [[None if np.isnan(v) else float(v) for v in column] for column in values.T]
    return dict(zip(names, rows, strict=True))


def fit_scene(
    scene: str | Path | scenes.Scene | Callable[..., scenes.Scene],
    to: str | Path | MeasuredCurve,
    parameters: Sequence[str],
    *,
    comm: MPI.Comm = MPI.COMM_WORLD,
    max_solves: int = MAX_SOLVES,
    **overrides: Any,
) -> SceneFit:
    """Fit material parameters of a scene to a measured curve. Collective.

    Parameters
    ----------
    scene : str, Path, Scene or callable
        As for `fem_snh.run`; static and in three dimensions, and contact without friction or
        multipliers.
    to : str, Path or MeasuredCurve
        A file with a column ``load``, from 0 to 1, or the scene's ``load_name``, and columns with
        the names of goals, such as ``right.force.x``.
    parameters : sequence of str
        E, nu and shape parameters of the material; the scene's values are the first guess.
    comm : MPI.Comm
        The communicator.
    max_solves : int
        Largest number of runs.
    **overrides
        As for `fem_snh.run`. A scene's parameter with the name of an argument above, as ``to`` of
        `press`, is given by ``fit_scene(fem_snh.scenes.load("press", to=0.8), ...)``.

    Raises
    ------
    BadInput
        On every rank, for bad input.
    Failed
        If the scene does not converge with its own values, or an adjoint solve fails.
    """
    first = on_every(comm, partial(scenes.load, scene, **overrides))
    curve = on_every(comm, partial(_read_curve, to, first))
    inverse = InverseProblem(comm, first, curve, parameters)
    start = inverse.start
    if np.count_nonzero(curve.known) < len(start):
        raise bad_value("parameters", list(parameters), "fewer parameters than measured values")
    if inverse.evaluate(start) is None:
        raise Failed(f"the scene did not converge at its own values: {inverse.failure}")
    found = least_squares(
        inverse.residual, start, jac=inverse.jacobian, bounds=inverse.bounds, x_scale="jac",
        ftol=_TOLERANCE, xtol=_TOLERANCE, gtol=1e-12, max_nfev=max_solves,
    )  # fmt: skip
    last = inverse.evaluate(found.x)
    assert last is not None
    residual, jacobian = last[0], last[1] / inverse.rates(found.x)
    at_bound = reaches_bound(jacobian, residual, *inverse.distances(found.x))
    at_bound |= np.asarray(found.active_mask) != 0
    known = curve.known
    goals = np.broadcast_to(np.arange(len(curve.names)), known.shape)[known]
    errors = standard_errors(jacobian, residual, goals, at_bound)
    fitted = np.full_like(curve.values, np.nan)
    fitted[known] = curve.values[known] + inverse.scale * residual
    values = inverse.values(found.x)
    return SceneFit(
        values,
        dict(zip(values, map(float, errors), strict=True)),
        curve,
        fitted,
        bool(found.status > 0),
        inverse.solves,
        inverse.linear,
        inverse.scene_at(found.x).materials[0].model_dump(mode="json"),
    )


@dataclass(frozen=True)
class _Parameter:
    """A parameter as a function of a dimensionless variable.

    The variable is log(1 - 2 nu) for nu, the logarithm of a positive parameter, and the multiple of
    the first value for any other parameter.

    Attributes
    ----------
    name : str
        The parameter's name.
    first : float
        The parameter's first value.
    accepted : pair of float
        The lowest and the highest value that the material accepts.
    """

    name: str
    first: float
    accepted: tuple[float, float]

    def variable(self, value: float) -> float:
        """Return the variable of a value; -inf if a positive parameter is not positive."""
        if self.name == "nu":
            return float(np.log(1 - 2 * value))
        if self.first > 0:
            return float(np.log(value)) if value > 0 else -np.inf
        return value / (self.first or 1.0)

    def value(self, z: float) -> float:
        """Return the value of a variable."""
        if self.name == "nu":
            return float(1 - np.exp(z)) / 2
        return float(np.exp(z)) if self.first > 0 else z * (self.first or 1.0)

    def rate(self, z: float) -> float:
        """Return the derivative of the value by the variable."""
        return (self.value(z + _STEP) - self.value(z - _STEP)) / (2 * _STEP)

    @property
    def bounds(self) -> tuple[float, float]:
        """The bounds of the variable, from ``accepted`` and `_WIDEST`."""
        ends = sorted(map(self.variable, self.accepted))
        z, width = self.variable(self.first), _WIDEST
        if self.name == "nu":
            width = np.inf
        elif self.first > 0:
            width = np.log(_WIDEST)
        # The differences go beyond the variables by a step.
        return max(ends[0] + 2 * _STEP, z - width), min(ends[1] - 2 * _STEP, z + width)


@dataclass
class _State:
    """A converged state with the n goals that are measured at its load.

    Attributes
    ----------
    load : float
        The load.
    x : PETSc.Vec
        The unknowns.
    measured : (goals,) bool
        Whether each goal of the curve is measured at this load.
    values : (n,) array
        The values of the measured goals.
    duals : list of PETSc.Vec
        The dual solutions of the measured goals.
    are_reactions : (n,) bool
        Whether a dual solution includes the goal's partial derivatives by parameters.
    """

    load: float
    x: PETSc.Vec
    measured: Mask
    values: Array
    duals: list[PETSc.Vec]
    are_reactions: Mask


class InverseProblem:
    """The m residuals of a curve as a function of a scene's k parameters, with derivatives.

    A residual is goal minus measured value, over the goal's largest measured value. Arguments z
    (k,) are dimensionless variables, one for each parameter. Collective.

    Parameters
    ----------
    comm : MPI.Comm
        The communicator.
    scene : Scene
        The scene with the first values.
    curve : MeasuredCurve
        The measurements.
    parameters : sequence of str
        Names of the parameters.

    Attributes
    ----------
    scale : (m,) array
        The divisors of the residuals.
    solves : int
        Runs so far.
    linear : int
        Iterations of the adjoint solves so far.
    failure : str
        The status of the last run that failed; "" if none did.
    """

    def __init__(
        self, comm: MPI.Comm, scene: scenes.Scene, curve: MeasuredCurve, parameters: Sequence[str]
    ) -> None:
        self.comm, self.scene, self.curve = comm, scene, curve
        self._check()
        first = {name: _value(scene, name) for name in parameters}
        if not first or len(first) < len(parameters):
            raise bad_value("parameters", list(parameters), "different names, one at least")
        # The energy is a function of nu, which does not jump where the default variant changes.
        variants = scene.materials[0].default_variants()
        self.scene = scenes.load(scene, **{f"material.{k}": v for k, v in variants.items()})
        function = materials.function(scene.materials[0].name)
        known = {"nu": _NU_RANGE, "E": (0.0, np.inf)}
        self._parameters = [
            _Parameter(name, value, known.get(name) or accepted_range(function, name))
            for name, value in first.items()
        ]
        self.scale = np.broadcast_to(curve.scales, curve.values.shape)[curve.known]
        self.solves = self.linear = 0
        self.failure = ""
        self._known: dict[bytes, tuple[Array, Array] | None] = {}

    def _check(self) -> None:
        """Raise BadInput for a scene that `fit_scene` does not support."""
        scene = self.scene
        if scene.time:
            raise BadInput("fit --to: expected a scene without [time]")
        if scene.kinematics:
            raise BadInput(f"fit --to: kinematics = {scene.kinematics!r}: expected a solid body")
        for feature in scene.features:
            if getattr(feature, "friction", 0):
                raise BadInput("fit --to: friction: expected contact without friction")
            if getattr(feature, "augmented", False):  # multipliers depend on parameters, too
                raise BadInput("fit --to: method = 'augmented_lagrangian': expected 'penalty'")

    @property
    def start(self) -> Array:
        """Return the variables of the scene's own values, (k,), within the bounds."""
        return np.clip([p.variable(p.first) for p in self._parameters], *self.bounds)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Return the lower and the upper bounds of the variables, (k,) each."""
        low, high = np.array([parameter.bounds for parameter in self._parameters]).T
        return low, high

    def values(self, z: Array) -> dict[str, float]:
        """Return the parameters by name at variables z."""
        return {p.name: p.value(float(x)) for p, x in zip(self._parameters, z, strict=True)}

    def rates(self, z: Array) -> Array:
        """Return the derivatives of the parameters by their variables, (k,)."""
        return np.array([p.rate(float(x)) for p, x in zip(self._parameters, z, strict=True)])

    def distances(self, z: Array) -> tuple[Array, Array]:
        """Return how far the parameters may decrease (numbers <= 0) and increase, (k,) each."""
        ends = [[p.value(b) for b in p.bounds] for p in self._parameters]
        low, high = np.sort(ends, axis=1).T
        values = np.array(list(self.values(z).values()))
        return low - values, high - values

    def residual(self, z: Array) -> Array:
        """Return the residuals, (m,); large ones if the run fails."""
        found = self.evaluate(z)
        return np.full(self.scale.shape, _FAILED) if found is None else found[0]

    def jacobian(self, z: Array) -> Array:
        """Return the derivatives of the residuals by the variables, (m, k)."""
        found = self.evaluate(z)
        assert found is not None
        return found[1]

    def evaluate(self, z: Array) -> tuple[Array, Array] | None:
        """Return residuals (m,) and derivatives (m, k) at rank 0's z; None if the run fails."""
        z = np.asarray(self.comm.bcast(z))
        key = z.tobytes()
        if key not in self._known:
            self._known[key] = self._solve(z)
        return self._known[key]

    def scene_at(self, z: Array) -> scenes.Scene:
        """Return the scene with its parameters at variables z."""
        keys = {k if k in _SCENE_KEYS else f"material.{k}": v for k, v in self.values(z).items()}
        return scenes.load(self.scene, **keys)

    def _solve(self, z: Array) -> tuple[Array, Array] | None:
        """Run the scene and differentiate its goals; None if the run fails."""
        self.solves += 1
        try:
            scene = self.scene_at(z)
        except BadInput as error:
            if self.solves == 1:
                raise
            self.failure = str(error)
            return None
        with ExitStack() as stack:
            stack.enter_context(solver.petsc_failures())
            stack.enter_context(scene_options(scene))
            setup = set_up(self.comm, scene)
            stack.callback(setup.destroy)
            states = self._states(setup)
            if not setup.stepper.done:
                self.failure = setup.stepper.failure_message()
                return None
            values = np.concatenate([state.values for state in states])
            columns = [self._derivative(z, k, setup, states) for k in range(len(z))]
        residual = (values - self.curve.values[self.curve.known]) / self.scale
        jacobian = np.stack(columns, axis=1) / self.scale[:, None]
        found: tuple[Array, Array] = self.comm.bcast((residual, jacobian))
        return found

    def _states(self, setup: Setup) -> list[_State]:
        """Return the states at the measured loads, with their goals and dual solutions."""
        problem, stepper = setup.problem, setup.stepper
        loads = self.curve.loads.tolist()  # numpy.float64 times a PETSc.Vec is an array
        between = [
            t
            for t in stepper.targets
            if t < loads[-1] and min(abs(t - load) for load in loads) >= _SAME_LOAD
        ]
        stepper.targets = sorted([*loads, *between])
        goals = named_goals(setup, self.curve.names)
        evaluate = bind_all(goals, problem)
        states = []
        for row in stepper:
            if not row["converged"] or row["load"] not in loads:
                continue
            measured = self.curve.known[loads.index(row["load"])]
            x, values = problem.x.copy(), evaluate()[measured]
            duals, are_reactions = self._duals(setup, goals, measured)
            states.append(_State(row["load"], x, measured, values, duals, are_reactions))
        return states

    def _duals(
        self, setup: Setup, goals: Sequence[Goal], measured: Mask
    ) -> tuple[list[PETSc.Vec], Mask]:
        """Return ``duals`` and ``are_reactions`` of `_State` at the present state.

        Raises Failed if the Hessian is singular.
        """
        problem = setup.problem
        direct = PETSc.KSP().create(problem.comm)
        if problem.is_assembled:
            set_direct_solver(direct)
        else:
            set_direct_solver_of_sum(direct)
        try:
            # A preconditioner need not suit an indefinite Hessian; factors do.
            for ksp in (setup.snes.getKSP(), direct):
                solve = HessianSolver(problem, ksp, _ADJOINT, ("exact",))
                at = Linearisation(problem, problem.x.duplicate(), solve)
                of_goals = [goal.dual(at, i) for goal in goals for i in range(len(goal.names))]
                of_goals = [dual for dual, use in zip(of_goals, measured, strict=True) if use]
                duals = at.solutions(of_goals)
                self.linear += solve.iterations
                if all(np.isfinite(z.norm()) for z in duals):
                    return duals, np.array([dual.offset is not None for dual in of_goals], bool)
        finally:
            direct.destroy()
        raise Failed(
            f"the adjoint solve at load {problem.load:g} did not converge: the Hessian is singular "
            "there"
        )

    def _derivative(self, z: Array, k: int, setup: Setup, states: Sequence[_State]) -> Array:
        """Return the total derivatives of the measured goals by variable ``k``, (m,)."""
        sums = [np.zeros(len(state.duals)) for state in states]
        goals = named_goals(setup, self.curve.names)
        for sign in (1, -1):
            moved = z.copy()
            moved[k] += sign * _STEP
            moved_scene = self.scene_at(moved)
            definition, u = define_scene(moved_scene, self.comm, setup.mesh)
            problem = definition.problem(u=u)
            gradient, evaluate = problem.x.duplicate(), bind_all(goals, problem)
            for total, state in zip(sums, states, strict=True):
                problem.set_load(state.load)
                state.x.copy(problem.x)
                problem.history.begin_step(problem.split(problem.x)[0])
                problem.gradient(problem.x, gradient)
                values = np.where(state.are_reactions, 0.0, evaluate()[state.measured])
                values -= [dual.dot(gradient) for dual in state.duals]
                total += sign / (2 * _STEP) * values
        return np.concatenate(sums)


def _value(scene: scenes.Scene, name: str) -> float:
    """Return the value of a parameter of the scene's material; raise BadInput if it has none."""
    if len(scene.materials) > 1:
        raise BadInput("fit --to: a scene with several materials: expected one material")
    (material,) = scene.materials
    known = {"E": material.E, "nu": material.nu} | materials.defaults(material.name)
    known |= {k: v for k, v in materials.TUNING.items() if isinstance(v, float)}
    known |= material.parameters
    numbers = {k: v for k, v in known.items() if type(v) in (int, float)}
    if name not in numbers:
        raise bad_value("parameters", name, f"one of {', '.join(numbers)}", numbers)
    value, (low, high) = numbers[name], _NU_RANGE
    if name == "nu" and not low <= value <= high:
        raise bad_value("nu", value, f"a number from {low:g} to {high:.7g} to start from")
    return float(value)


def _read_curve(to: str | Path | MeasuredCurve, scene: scenes.Scene) -> MeasuredCurve:
    """Return the measurements of a file, without load 0; raise BadInput for a mistake in it."""
    if isinstance(to, MeasuredCurve):
        return to
    if not isinstance(to, str | Path):
        raise bad_value("to", to, "a file or a MeasuredCurve")
    path = Path(to)
    _, ((_, names), *rows) = read_cells(path)
    if len(names) < 2 or any(map(is_number, names)):
        raise BadInput(
            f"{path}: expected a first line with 'load' or {scene.load_name!r} and names of goals, "
            "e.g. right.force.x"
        )
    low, high = (0.0, 1.0) if names[0] == _LOAD else scene.load_range
    if names[0] not in (_LOAD, scene.load_name):
        raise bad_value(f"{path}: column", names[0], f"'load' or '{scene.load_name}' first")
    numbers = []
    for line, cells in rows:
        if (
            len(cells) != len(names)
            or not all(c == "" or is_number(c) for c in cells)
            or not cells[0]
        ):
            raise BadInput(f"{path}: line {line}: expected {len(names)} numbers")
        numbers.append([float(cell) if cell else np.nan for cell in cells])
    if not numbers:
        raise BadInput(f"{path}: no line of numbers")
    table = np.array(numbers)
    loads = (table[:, 0] - low) / (high - low)
    keep = loads > _SAME_LOAD  # the state at rest
    table, loads = table[keep], loads[keep]
    if not len(loads) or not (loads <= 1 + _SAME_LOAD).all() or not (np.diff(loads) > 0).all():
        raise BadInput(
            f"{path}: column {names[0]}: expected ascending numbers between {low:g} and {high:g}"
        )
    return MeasuredCurve(names[0], table[:, 0], np.minimum(loads, 1.0), names[1:], table[:, 1:])
