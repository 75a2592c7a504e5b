"""The errors of goals as they are printed and recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import reduce
from itertools import chain
from math import floor, inf, log10, nan, sqrt
from operator import or_
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fem_snh.accuracy.effectivity import MISSED, measure
from fem_snh.arrays import Array
from fem_snh.errors import in_words
from fem_snh.problem.goals import Goal, names_of, vector_of
from fem_snh.problem.problem import Problem

if TYPE_CHECKING:
    from fem_snh.accuracy.path_errors import GoalHistory

#: Components below this part of their vector are not printed: the solvers leave that much.
_SHOWN = 1e-5
#: The parts of an error that are those of steps.
TIME_STEPS, LOAD_STEPS = "time steps", "load steps"
#: Why a force of contact has no estimate where neither solution touches.
NO_CONTACT = "nothing touches on these cells, but finer ones may"
#: Errors of forces that nobody named are relative to at least this part of the largest force.
SMALL_FORCE = 0.1


@dataclass(frozen=True)
class Place:
    """Where most of a goal's error is.

    Attributes
    ----------
    share : float
        The part of the sum of the indicators' sizes that is there.
    cells : int
        The number of these cells.
    of : int
        The number of all cells.
    largest : tuple of float
        The centre of the cell with the largest error [length], (dim,).
    group : str
        The group of surfaces, curves or points that most of them touch, and the fewest other
        cells; "" for none that fewer than half of all cells touch.
    """

    share: float
    cells: int
    of: int
    largest: tuple[float, ...]
    group: str = ""

    def __str__(self) -> str:
        where = ", ".join(f"{x:.4g}" for x in self.largest)
        at = f" at '{self.group}'" if self.group else ""
        return (
            f"{100 * self.share:.0f} % of it in {self.cells:,} of {self.of:,} cells{at}, most in "
            f"that at ({where})"
        )


@dataclass(frozen=True)
class GoalError:
    """A goal of a solution with its error.

    Attributes
    ----------
    value : float
        The goal of the run.
    estimate : float or None
        What its discretisation says is to be added to it; None: nothing.
    scale : float
        The largest size of a component of the same vector, and at least a thousandth of the largest
        displacement or force.
    parts : dict of float
        The parts of the estimate by their source: mesh, penalty, time or load steps.
    missed : dict of float
        What each part may miss; that of "algebra" is what further iterations would change.
    bound : float or None
        The bound of the error of `corrected`; None: unknown, as one level alone has no bound.
    theta : float
        The effectivity of the part of the mesh that two levels measured; NaN without two.
    factor : float
        Of the estimate's part of the mesh, in the error.
    confirmed : bool
        Whether the effectivity confirms the estimate.
    small : bool
        Whether `scale` is a part of that of a larger force.
    least : float
        The least bound: of a displacement from the largest error of one in the body.
    asked : bool
        Whether it was asked for, and does not only complete a vector.
    reason : str
        Why this goal has no estimate, where others may have one, or an uncertain one.
    """

    value: float
    estimate: float | None = None
    scale: float = 0.0
    parts: dict[str, float] = field(default_factory=dict)
    missed: dict[str, float] = field(default_factory=dict)
    bound: float | None = None
    theta: float = nan
    factor: float = 1.0
    confirmed: bool = True
    small: bool = False
    least: float = 0.0
    asked: bool = True
    reason: str = ""

    @property
    def error(self) -> float | None:
        """What is to be added to the value; None without an estimate."""
        return None if self.estimate is None else self.of_others + self.factor * self.of_mesh

    @property
    def of_mesh(self) -> float:
        """The part of the estimate that another mesh measures."""
        return self.parts.get("mesh", 0.0)

    @property
    def of_others(self) -> float:
        """The parts that are measured on this mesh, by steps and stiffnesses."""
        return (self.estimate or 0.0) - self.of_mesh

    @property
    def parts_of_error(self) -> dict[str, float]:
        """The parts of the error by their source."""
        return self.parts | ({"mesh": self.factor * self.of_mesh} if self.of_mesh else {})

    @property
    def corrected(self) -> float | None:
        """The value with the error added."""
        return None if self.error is None else self.value + self.error

    @property
    def relative(self) -> float | None:
        """The size of the error over that of the value; None for a value that is rounding."""
        if self.error is None or abs(self.value) <= _SHOWN * self.scale:
            return None
        return abs(self.error / self.value)

    @property
    def within(self) -> float:
        """The bound over the scale; infinite without a bound."""
        if self.bound is None:
            return inf
        return self.bound / self.scale if self.scale > 0 else 0.0

    def known_from(self, coarser: GoalError) -> GoalError:
        """Return the goal with its difference to the corrected value of a coarser level.

        If it is larger than that level's own by more than the bound, it is the bound.
        """
        if coarser.corrected is None or coarser.bound is None:
            return replace(self, reason=coarser.reason)
        error, bound = coarser.corrected - self.value, coarser.bound
        if abs(error) > abs(coarser.error or 0.0) + bound:
            bound = abs(error)
        parts, missed = {"mesh": error}, {"mesh": bound}
        return replace(
            coarser, value=self.value, estimate=error, parts=parts, missed=missed, factor=1.0,
            bound=bound,
        )  # fmt: skip

    def contribution(self, source: str) -> float:
        """Return what a part of the error adds to the bound, over the scale.

        What levels measured beside what the parts may miss is added to that of the mesh. An
        estimate that is not confirmed adds what it may miss: the next level may confirm it.
        """
        part = self.missed.get(source, 0.0)
        if source == "mesh" and self.bound is not None and self.confirmed:
            part += max(self.bound - self.all_missed, 0.0)
        return part / self.scale if self.scale > 0 else 0.0

    @property
    def all_missed(self) -> float:
        """What the parts of the estimate may miss in all."""
        return sum(self.missed.values())

    @property
    def is_zero(self) -> bool:
        """Whether the value is rounding beside the other components, and the error unsettled."""
        limit = _SHOWN * self.scale
        unsettled = max(limit, self.missed.get("algebra", 0.0))
        return abs(self.value) <= limit and abs(self.error or 0.0) <= unsettled

    def record(self) -> dict[str, Any]:
        """Return the entry of ``goals`` in run.json."""
        return {
            "value": self.value,
            "error": self.error,
            "relative": self.relative,
            "corrected": self.corrected,
            "bound": self.bound,
            **({} if self.bound is None else {key: getattr(self, key) for key in _MEASURED}),
            **({"parts": self.parts_of_error} if len(self.parts) > 1 else {}),
            **({"reason": self.reason} if self.reason else {}),
        }

    def text(self, name: str) -> str:
        """Return one line, "corner.y 6.631, error +0.267 +- 0.1 (4.0 %), corrected 6.898".

        Of one level alone it is an estimate, without a bound.
        """
        if self.error is None:
            reason = f": {self.reason}" if self.reason else ""
            return f"{name} {self.value:.6g}, no estimate{reason}"
        what, bound, known = "estimated error", "", self.all_missed
        if self.bound is not None:
            what, bound, known = "error", f" +- {self.bound:.2g}", self.bound
        if known > abs(self.error):
            return f"{name} {self.value:.6g}, {what} below {self._share(abs(self.error) + known)}"
        value, corrected = (_shown(x, self.error) for x in (self.value, self.value + self.error))
        share = "" if self.relative is None else f" ({_share(self.relative)})"
        of = f": {text}" if (text := self.parts_text) else ""
        if self.reason:
            corrected += f"; {self.reason}"
        return f"{name} {value}, {what} {self.error:+.3g}{bound}{share}{of}, corrected {corrected}"

    def line(self, name: str, asked: float) -> str:
        """Return the line of a goal on a level, "corner.y 6.898 +- 0.02 (0.29 %) (corrected)"."""
        if self.bound is None or self.corrected is None:
            return f"  {self.text(name)}"
        which = " (corrected)" if self.error else ""
        mark = "" if self.within <= asked else "  not yet"
        share = f"{100 * self.within:.2g} %"
        if self.small:
            share += f" of {SMALL_FORCE:g} of the largest force"
        of = f"  ({text})" if (text := self.parts_text) else ""
        return f"  {name} {self.corrected:.6g} +- {self.bound:.2g} ({share}){which}{mark}{of}"

    @property
    def parts_text(self) -> str:
        """The parts of an error, "time steps +0.00015, mesh -0.0052"; "" for one."""
        if len(self.parts) < 2:
            return ""
        return ", ".join(f"{s} {part:+.2g}" for s, part in self.parts_of_error.items())

    def _share(self, bound: float) -> str:
        """Return a bound in per cent of the value; as it is if the value is not larger than it."""
        if abs(self.value) <= max(bound, _SHOWN * self.scale):
            return f"{bound:.2g}"
        return _share(bound / abs(self.value))


class GoalCurve(NamedTuple):
    """A goal after the steps of a run, by the rounded load.

    Attributes
    ----------
    values : dict of float
        The values of the run.
    errors, bounds : dict of float
        What is to be added to them, and by how much the sums may be off.
    """

    values: dict[float, float]
    errors: dict[float, float]
    bounds: dict[float, float]

    def seen_from(self, values: Mapping[float, float]) -> GoalCurve:
        """Return the curve of other ``values``, whose errors lead to the same corrected ones."""
        here, errors = {at: values[at] for at in self.values if at in values}, {}
        for at, value in here.items():
            errors[at] = self.values[at] + self.errors[at] - value
        return GoalCurve(here, errors, {at: self.bounds[at] for at in here})


def _shown(value: float, error: float) -> str:
    """Return a value with three digits of its error, ten at most."""
    if not (error and value):
        return f"{value:.6g}"
    digits = 3 + floor(log10(abs(value))) - floor(log10(abs(error)))
    return f"{value:#.{min(max(3, digits), 10)}g}".rstrip(".")


def _share(part: float) -> str:
    """Return a part in per cent with two digits; above 1 as a multiple."""
    return f"{100 * part:#.2g}".rstrip(".") + " %" if part < 1 else f"{part:.3g} times"


def with_bounds(
    goals: Mapping[str, GoalError],
    coarser: Sequence[Mapping[str, GoalError]],
    left: float,
    unmeasured: Mapping[str, float] = {},
) -> dict[str, GoalError]:
    """Return goals with the bounds that they and the same on coarser levels measure.

    Levels that do not have a vector, or no estimate of it, are left out.

    Parameters
    ----------
    goals : mapping of GoalError
        The goals of a level.
    coarser : sequence of mapping
        Those of the levels before, the coarsest first.
    left : float
        The part of the last one's error of the mesh that smooth solutions would leave, with the
        order 2p. An estimate below it is small by chance; with one effectivity only the order p is
        believed.
    unmeasured : mapping of float, optional
        The errors on the level before of which the effectivity says nothing, by goal.
    """
    found = dict(goals)
    for vector in dict.fromkeys(map(vector_of, goals)):
        names = [name for name in goals if vector_of(name) == vector]
        known: list[list[GoalError]] = []
        for level in (*coarser, goals):
            if all(name in level and level[name].estimate is not None for name in names):
                known.append([level[name] for name in names])
        if len(known) < 2 or known[-1][0] is not goals[names[0]]:
            continue
        known = known[-3:]  # three levels have two effectivities
        values = np.array([[goal.value + goal.of_others for goal in level] for level in known])
        estimates = np.array([[goal.of_mesh for goal in level] for level in known])
        missed = np.array([[goal.missed.get("mesh", 0.0) for goal in level] for level in known])
        once = known[-2][0].bound is None or not known[-2][0].confirmed
        least = np.maximum(missed[-1], (sqrt(left) if once else left) * missed[-2])
        theta, factor, bounds, confirmed = measure(values, estimates, least)
        for name, goal, before, bound in zip(names, known[-1], known[-2], bounds, strict=True):
            others = goal.all_missed - goal.missed.get("mesh", 0.0)
            goal = replace(goal, theta=theta, factor=factor, confirmed=confirmed)
            bound = max(float(bound), goal.least) + others + unmeasured.get(name, 0.0)
            found[name] = _bounded(goal, bound, before)
    return found


def _bounded(goal: GoalError, bound: float, coarser: GoalError) -> GoalError:
    """Return a goal with a bound, which a coarser level's may contradict.

    It is at least the change from a value that differs by more than both bounds; and a coarser
    bound that was confirmed, if the effectivity is outside of 0.5 to 1.5 and does not confirm one.
    """
    corrected = goal.corrected or 0.0
    if coarser.bound is not None and coarser.corrected is not None:
        change = abs(corrected - coarser.corrected)
        bound = max(bound, change) if change > bound + coarser.bound else bound
        if coarser.confirmed and abs(goal.theta - 1) > MISSED and not goal.confirmed:
            bound = max(bound, coarser.bound)
    return replace(goal, bound=bound, scale=max(goal.scale, abs(corrected)))


def with_scales_of_forces(goals: Mapping[str, GoalError]) -> dict[str, GoalError]:
    """Return goals of which small forces are relative to a part of the largest one."""
    forces = [name for name in goals if vector_of(name).endswith(".force")]
    least = SMALL_FORCE * max((goals[name].scale for name in forces), default=0.0)
    small = {
        n: replace(goals[n], scale=least, small=True) for n in forces if goals[n].scale < least
    }
    return dict(goals) | small


#: What two levels measured, for run.json.
_MEASURED = "within", "theta", "factor", "confirmed"
#: Numbers of an `Estimate` of which the sum counts at several loads; of others the largest does.
_SUMS = "newton", "linear", "seconds", "jit"


@dataclass
class Estimate:
    """The errors of the goals of a solution.

    Attributes
    ----------
    goals : dict of GoalError
        The goals by name.
    reason : str
        Why there is no estimate; empty if there is one.
    on_no_mesh : bool
        Whether a finer mesh would not have one either.
    steps_too_long : bool
        Whether there is none because steps fail, and shorter ones may not.
    element : str
        The lifted element.
    dofs, memory : int, float
        Its unknowns and the memory that it needs [bytes], before it is created.
    saturation : float
        The factor by which the difference of the two solutions was multiplied.
    newton, linear : int
        Newton iterations, those with stiffer penalties among them, and linear iterations.
    again : int
        The steps in which the path is followed again; 0 where the end does not depend on it.
    seconds, jit : float
        Elapsed time, and the part of it that compiled kernels, elements and forms.
    indicators : dict of arrays
        The error of each goal in each cell of this rank, for errors that are not negligible.
    places : dict of Place
        Where half of each of them is.
    left_out : list of str
        What the errors do not include, or what was not measured for them: a line each.
    loads : dict of float
        The loads of goals that are not those of the end.
    duration : float or None
        The time [s] at load 1; None in statics.
    curves : dict of GoalCurve
        The goals after each step, where a coarser run measured their errors.
    history : GoalHistory or None
        All components of the goals after each step, unless the run was resumed.
    """

    goals: dict[str, GoalError] = field(default_factory=dict)
    reason: str = ""
    on_no_mesh: bool = False
    steps_too_long: bool = False
    element: str = ""
    dofs: int = 0
    memory: float = 0.0
    saturation: float = 1.0
    newton: int = 0
    linear: int = 0
    again: int = 0
    seconds: float = 0.0
    jit: float = 0.0
    indicators: dict[str, Array] = field(default_factory=dict, repr=False)
    places: dict[str, Place] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    loads: dict[str, float] = field(default_factory=dict)
    duration: float | None = None
    curves: dict[str, GoalCurve] = field(default_factory=dict, repr=False)
    history: GoalHistory | None = field(default=None, repr=False)

    @classmethod
    def merged(cls, estimates: Mapping[float, Estimate], names: Sequence[str]) -> Estimate:
        """Return one estimate of those at several loads, with the goals in the order of names."""
        combined: dict[str, Any] = {}
        for key in (entry.name for entry in fields(cls)):
            values = [getattr(estimate, key) for estimate in estimates.values()]
            if isinstance(values[0], dict):
                tables = reduce(or_, values)
                combined[key] = {name: tables[name] for name in names if name in tables}
            elif isinstance(values[0], list):
                combined[key] = list(dict.fromkeys(chain(*values)))
            elif values[0] is None or isinstance(values[0], str):
                combined[key] = next(filter(None, values), values[0])
            else:
                combined[key] = sum(values) if key in _SUMS else max(values)
        combined["loads"] = {n: load for load, e in estimates.items() if load < 1 for n in e.goals}
        return cls(**combined)

    def values(self, goals: Sequence[Goal]) -> Array:
        """Return the values of goals in the run, (scalars,)."""
        return np.array([self.goals[name].value for name in names_of(goals)])

    def scales(self, goals: Sequence[Goal]) -> Array:
        """Return what the errors of goals are relative to, (scalars,)."""
        return np.array([self.goals[name].scale for name in names_of(goals)])

    @property
    def asked(self) -> dict[str, GoalError]:
        """The goals that were asked for, by name."""
        return {name: goal for name, goal in self.goals.items() if goal.asked}

    def label(self, name: str) -> str:
        """Return what the line of a goal begins with: its name, and its load if not the end."""
        if (load := self.loads.get(name)) is None:
            return name
        at = f"load {load:.6g}" if self.duration is None else f"time {load * self.duration:.6g} s"
        return f"{name} at {at}"

    def announcement(self) -> str:
        """Return the line to print before the lifted problem is created."""
        count = f"{self.again:,} step{'s' if self.again > 1 else ''}"
        steps = f"the path again in {count}, and with " if self.again else ""
        return (
            f"error estimate: {steps}{self.dofs:,} unknowns of {self.element} on the same cells, "
            f"about {self.memory / 1e6:.2g} MB"
        )

    def lines(self) -> list[str]:
        """Return what is printed: a line for each goal, or why there is no estimate."""
        if self.reason:
            return [f"no estimate of the error: {self.reason}"]
        shown = {name: goal for name, goal in self.asked.items() if not goal.is_zero}
        lines = [goal.text(self.label(name)) for name, goal in shown.items()]
        return [*lines, *self.untouched.values(), *self.remarks]

    @property
    def remarks(self) -> list[str]:
        """The lines that follow the goals: where the largest error is, and what is left out."""
        return [*filter(None, [self._where]), *self.left_out]

    @property
    def untouched(self) -> dict[str, str]:
        """The lines of forces of contact by name, without an estimate as nothing touches."""
        names = [vector_of(n) for n, goal in self.goals.items() if goal.reason == NO_CONTACT]
        return {name: f"{name} 0, no estimate: {NO_CONTACT}" for name in names}

    @property
    def _where(self) -> str:
        """Return the line that says where most of the largest error is; empty without one."""
        sizes = {
            name: abs(goal.error or 0.0) / goal.scale
            for name, goal in self.goals.items()
            if name in self.places and goal.scale > 0
        }
        if not sizes:
            return ""
        largest = max(sizes, key=sizes.__getitem__)
        return f"where the error of {largest} is: {self.places[largest]}"

    def __str__(self) -> str:
        return "\n".join(self.lines())

    def record(self) -> dict[str, Any]:
        """Return the entry ``estimate`` of run.json."""
        keys = ("saturation", "left_out", *_SUMS)
        return {
            "reason": self.reason or None,
            "element": self.element,
            "dofs": self.dofs,
            "memory_mb": self.memory / 1e6,
            **{key: getattr(self, key) for key in keys},
            "places": {name: asdict(place) for name, place in self.places.items()},
        }


class NoEstimate(Exception):
    """There is no estimate of the error; the text says why in one line."""


class StepsTooLong(NoEstimate):
    """Steps fail on a path that is followed again with fewer of them; shorter ones may not."""


class NoEstimateOnAnyMesh(NoEstimate):
    """There is none for a reason that a finer mesh does not change."""


def check_shapes(problem: Problem) -> None:
    """Raise NoEstimate for a bone or rigid part that is a shape, whose surface no cell follows.

    Its solid ends at the last of the nodes in it: an error that another element on the same cells
    does not measure.
    """
    bones = [f"bone '{b.bone.name}'" for b in problem.dirichlet.bones if b.bone.shape is not None]
    parts = (
        [f"rigid part '{problem.rigid.names[i]}'" for i in problem.rigid.shapes]
        if problem.rigid
        else []
    )
    for solid in (*bones, *parts):
        raise NoEstimateOnAnyMesh(
            f"the {solid} is a shape, which ends at the last of its nodes: it needs a 'group' of "
            "the mesh"
        )


def check_problem(problem: Problem) -> None:
    """Raise NoEstimate for a state that depends on its path. Collective."""
    again = "follow the path by steps() of the problem, from its beginning"
    if problem.motion:
        raise NoEstimateOnAnyMesh(f"the motion is another one in another element: {again}")
    if problem.history.is_kept(problem.comm):
        names = in_words(f"'{name}'" for name in problem.history.by_name)
        raise NoEstimateOnAnyMesh(
            f"{names} keeps friction or multipliers from step to step, which another element "
            f"does not have: {again}"
        )
