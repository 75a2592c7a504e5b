"""The errors of goals as they are printed and recorded."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields
from functools import reduce
from itertools import chain
from math import floor, hypot, log10
from operator import or_
from typing import Any

import numpy as np
import numpy.typing as npt

from fem_snh.accuracy.goals import vector_of
from fem_snh.errors import in_words
from fem_snh.problem.problem import Problem

#: An estimate is printed as a bound if more than this part of it is unsettled.
UNSETTLED = 0.2
#: Components below this part of their vector are not printed: the solvers leave that much.
_SHOWN = 1e-5
#: The parts of an error that are those of steps.
STEPS = TIME_STEPS, LOAD_STEPS = "time steps", "load steps"
#: Why a force of contact has no estimate where neither solution touches.
NO_CONTACT = "nothing touches on these cells, but finer ones may"
#: Why a force of contact is uncertain that is smaller than its error and than this part of the
#: largest force: contact begins at a few nodes, and each finer mesh may have several times as much.
BEGINS, SMALL_FORCE = "it only begins to touch, and on finer cells may touch more", 0.1


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
    """A goal of a solution with the estimate of its error.

    Attributes
    ----------
    value : float
        The goal of the run.
    error : float or None
        The estimate of what is to be added to it; None: no estimate.
    scale : float
        The largest size of a component of the same vector, and at least a thousandth of the largest
        displacement or force.
    unsettled : float
        By how much further Newton iterations would change the estimate, about.
    parts : dict of float
        The parts of the estimate by their source: mesh, penalty, time or load steps; empty if there
        is one source, the mesh.
    steps_bound : float
        A bound of the error of time or load steps; infinite where none is known.
    mesh_bound, penalty_bound : float
        In time, bounds of what shorter steps change of the parts of the mesh and of penalties.
    penalty_change : float
        By how much the lifted problem has another part of penalties than the run's element, where
        both are known.
    missed : float
        Of an error of several parts, what they may miss in all.
    of_body : float
        Of a displacement of a point, the estimate of the largest error of one in the body.
    of_size : float
        Of the stress around a point, the estimate of the mean of the size of its error there.
    of_path : float
        In time, the largest part of the mesh in the last half of the motion.
    reason : str
        Why this goal has no estimate, where others may have one, or an uncertain one.
    """

    value: float
    error: float | None = None
    scale: float = 0.0
    unsettled: float = 0.0
    parts: dict[str, float] = field(default_factory=dict)
    steps_bound: float = 0.0
    mesh_bound: float = 0.0
    penalty_bound: float = 0.0
    penalty_change: float = 0.0
    missed: float = 0.0
    of_body: float = 0.0
    of_size: float = 0.0
    of_path: float = 0.0
    reason: str = ""

    @property
    def corrected(self) -> float | None:
        """The value with the estimate added."""
        return None if self.error is None else self.value + self.error

    @property
    def relative(self) -> float | None:
        """The size of the estimate over that of the value; None for a value that is rounding."""
        if self.error is None or abs(self.value) <= _SHOWN * self.scale:
            return None
        return abs(self.error / self.value)

    @property
    def is_found(self) -> bool:
        """Whether an estimate says more than a bound.

        No more than a fifth of it, `UNSETTLED`, is unsettled, and its parts do not cancel: they may
        miss no more than it is.
        """
        size = abs(self.error or 0.0)
        return size * UNSETTLED >= self.unsettled and size >= self.missed

    @property
    def is_zero(self) -> bool:
        """Whether value and estimate are rounding beside the other components."""
        limit = _SHOWN * self.scale
        return abs(self.value) <= limit and abs(self.error or 0.0) <= limit

    @property
    def bound(self) -> float | None:
        """The bound of the error where there is no more than one; else None."""
        if self.error is None:
            return None
        if self.is_found and not bounded_steps(self.parts, self.steps_bound):
            return None
        if not self.parts:
            return abs(self.error) + self.unsettled
        sizes = {source: abs(part) for source, part in self.parts.items()}
        on_path = [sizes.pop(source) for source in STEPS if source in sizes]
        if on_path:  # what is unsettled are the bounds
            sizes["mesh"] = max(sizes.get("mesh", 0.0), self.of_path)
            unsettled = max(*on_path, self.steps_bound) + self.mesh_bound + self.penalty_bound
        else:
            unsettled = self.unsettled
        return sum(sizes.values()) + unsettled + self.missed

    def record(self) -> dict[str, Any]:
        """Return the entry of ``goals`` in run.json."""
        return {
            "value": self.value,
            "error": self.error,
            "relative": self.relative,
            "corrected": self.corrected,
            **({"bound": self.bound} if self.bound is not None else {}),
            **({"parts": self.parts} if self.parts else {}),
            **({"reason": self.reason} if self.reason else {}),
        }

    def text(self, name: str) -> str:
        """Return one line, "corner.y 6.631, error +0.267 (4.0 %), corrected 6.898"."""
        if self.error is None:
            reason = f": {self.reason}" if self.reason else ""
            return f"{name} {self.value:.6g}, no estimate{reason}"
        parts = parts_text(self.parts, self.steps_bound)
        of = f": {parts}" if parts else ""
        if not self.is_found:
            bound = self._bound_text(self.bound or 0.0)
            cancel = self.missed > abs(self.error)
            of = of if cancel or bounded_steps(self.parts, self.steps_bound) else ""
            return f"{name} {self.value:.6g}, error below {bound}{of}"
        value, corrected = (_shown(x, self.error) for x in (self.value, self.value + self.error))
        share = "" if self.relative is None else f" ({_share(self.relative)})"
        but = f"; {self.reason}" if self.reason else ""
        return f"{name} {value}, error {self.error:+.3g}{share}{of}, corrected {corrected}{but}"

    def _bound_text(self, bound: float) -> str:
        """Return a bound in per cent of the value; as it is if the value is not larger than it."""
        if abs(self.value) <= max(bound, _SHOWN * self.scale):
            return f"{bound:.2g}"
        return _share(bound / abs(self.value))


def no_contact_text(force: str) -> str:
    """Return the line of a force of contact without an estimate."""
    return f"{force} 0, no estimate: {NO_CONTACT}"


def bounded_steps(parts: Mapping[str, float], steps_bound: float) -> str:
    """Return the steps whose error has a bound alone; "" where it has an estimate, or is zero."""
    return next((s for s in STEPS if parts.get(s) == 0 and steps_bound > 0), "")


def parts_text(parts: Mapping[str, float], steps_bound: float) -> str:
    """Return the parts of an error, "time steps +0.00015, mesh -0.0052"; "" without any.

    Where the error of steps has no estimate, which is then zero, its bound is shown.
    """
    bounded = bounded_steps(parts, steps_bound)
    return ", ".join(
        f"{source} below {steps_bound:.2g}" if source == bounded else f"{source} {part:+.2g}"
        for source, part in parts.items()
    )


def _shown(value: float, error: float) -> str:
    """Return a value with three digits of its error, ten at most."""
    if not (error and value):
        return f"{value:.6g}"
    digits = 3 + floor(log10(abs(value))) - floor(log10(abs(error)))
    return f"{value:#.{min(max(3, digits), 10)}g}".rstrip(".")


def _share(part: float) -> str:
    """Return a part in per cent with two digits; above 1 as a multiple."""
    return f"{100 * part:#.2g}".rstrip(".") + " %" if part < 1 else f"{part:.3g} times"


#: Numbers of an `Estimate` of which the sum counts at several loads; of others the largest does.
_SUMS = "newton", "linear", "penalty_newton", "seconds", "jit"


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
        Its Newton and linear iterations.
    penalty_newton : int
        The Newton iterations with stiffer penalties.
    again : int
        The steps in which the path is followed again; 0 where the end does not depend on it.
    seconds, jit, repeated : float
        Elapsed time, the part of it that compiled kernels, elements and forms, and that in which
        errors were found again, as the steps were too long.
    indicators : dict of arrays
        The error of each goal in each cell of this rank, for errors above 1e-4 of the goal.
    places : dict of Place
        Where half of each of them is.
    may_be_unstable : bool
        Whether the stability of the lifted equilibrium matters, and is unknown.
    left_out : list of str
        What the errors do not include, or what was not measured for them: a line each.
    narrow : list of str
        The obstacles whose contact is narrower than a cell.
    of_curved : float
        What edges of degree 2 leave out of round faces, over the volume of the mesh.
    loads : dict of float
        The loads of goals that are not those of the end.
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
    penalty_newton: int = 0
    again: int = 0
    seconds: float = 0.0
    jit: float = 0.0
    repeated: float = 0.0
    indicators: dict[str, npt.NDArray[np.float64]] = field(default_factory=dict, repr=False)
    places: dict[str, Place] = field(default_factory=dict)
    may_be_unstable: bool = False
    left_out: list[str] = field(default_factory=list)
    narrow: list[str] = field(default_factory=list)
    of_curved: float = 0.0
    loads: dict[str, float] = field(default_factory=dict)

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
            elif isinstance(values[0], str):
                combined[key] = next(filter(None, values), "")
            else:
                combined[key] = sum(values) if key in _SUMS else max(values)
        combined["loads"] = {n: load for load, e in estimates.items() if load < 1 for n in e.goals}
        return cls(**combined)

    def label(self, name: str) -> str:
        """Return what the line of a goal begins with: its name, and its load if not the end."""
        return f"{name} at load {self.loads[name]:.6g}" if name in self.loads else name

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
        shown = {name: goal for name, goal in self.goals.items() if not goal.is_zero}
        lines = [goal.text(self.label(name)) for name, goal in shown.items()]
        return [*lines, *map(no_contact_text, self._open), *self.remarks]

    @property
    def remarks(self) -> list[str]:
        """The lines that follow the goals: where the largest error is, and what is left out."""
        doubt = (
            f"the state of {self.element} may be unstable, as iterations leave that open: a "
            "scene's stability = true tells"
        )
        doubts = [doubt] if self.may_be_unstable else []
        return [*filter(None, [self._where]), *doubts, *self.left_out]

    @property
    def _open(self) -> list[str]:
        """The forces of contact without an estimate, as nothing touches."""
        names = [vector_of(n) for n, goal in self.goals.items() if goal.reason == NO_CONTACT]
        return list(dict.fromkeys(names))

    @property
    def untouched(self) -> dict[str, str]:
        """The lines of forces of contact by name: nothing touches, or only begins to."""
        found = {name: no_contact_text(name) for name in self._open}
        sizes: dict[str, list[GoalError]] = {}
        for name, goal in self.goals.items():
            if goal.reason == BEGINS:
                sizes.setdefault(vector_of(name), []).append(goal)
        for name, goals in sizes.items():
            here = hypot(*(goal.value for goal in goals))
            better = hypot(*(goal.value + (goal.error or 0.0) for goal in goals))
            found[name] = f"{name} {here:.3g}, of the better element {better:.3g}: {BEGINS}"
        return found

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
        keys = ("saturation", "may_be_unstable", "left_out", *_SUMS)
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


class ElementDoesNotFit(NoEstimate):
    """The problem cannot have this element; another one may do."""


class StepsTooLong(NoEstimate):
    """Steps fail on a path that is followed again with fewer of them; shorter ones may not."""


class NoEstimateOnAnyMesh(NoEstimate):
    """There is none for a reason that a finer mesh does not change."""


def depends_on_path(problem: Problem) -> bool:
    """Return whether a state depends on those before it: in time, with friction. Collective."""
    return problem.motion is not None or problem.history.is_kept(problem.comm)


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
