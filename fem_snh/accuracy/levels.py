"""Decide on the levels of a run to a required accuracy: when it ends, and how fine the next is.

A goal is within the request if the bound of the error of its corrected value is, which two levels
measure (`fem_snh.accuracy.effectivity`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from math import ceil, inf, log
from typing import Any

import numpy as np

from fem_snh.accuracy.goal_errors import (
    LOAD_STEPS,
    TIME_STEPS,
    Estimate,
    GoalError,
    with_bounds,
    with_scales_of_forces,
)
from fem_snh.accuracy.refinement import left_by_uniform
from fem_snh.arrays import Array
from fem_snh.problem.goals import vector_of

#: Largest factors by which the time steps of a level are shorter, and its penalties stiffer: with
#: more, it finds no equilibrium from the state of the last.
_MOST_SHORTER, _MOST_STIFFER = 4.0, 10.0
#: Levels without an estimate after which the run ends: the first meshes may be too coarse.
_MOST_WITHOUT = 3
#: Factors between the sizes of cells of two levels: least and most; and to measure an estimate, by
#: the dimension, with about four times the cells.
_LEAST_REFINEMENT, _MOST_REFINEMENT, _TO_MEASURE = 1.3, 2.0, {2: 2.0, 3: 1.5}
#: The error that the next level aims at, over the request.
_AIM = 0.7
#: The parts of an error that are those of steps, and the power of the number of steps with which
#: they decrease: within a load step friction acts along a chord.
_STEPS = {TIME_STEPS: 2.0, LOAD_STEPS: 1.0}
#: A level that was expected to end in ``max_time`` may last until so many times that.
_OVERRUN = 2.0
#: Power of the unknowns with which the time of a level grows (docs/results/scaling.md).
_TIME_POWER = 1.2


@dataclass(frozen=True)
class Forecast:
    """What the next level will cost, about.

    Attributes
    ----------
    cells, dofs : int
        Its cells and unknowns.
    seconds, memory : float
        Elapsed seconds, with the estimate; memory of the estimate's problem [bytes].
    steps : str
        The number of steps in which the path is followed; "" where the end does not depend on it.
    """

    cells: int
    dofs: int
    seconds: float
    memory: float
    steps: str = ""

    def __str__(self) -> str:
        steps = f"{self.steps}, " if self.steps else ""
        return (
            f"about {self.cells:,} cells, {self.dofs:,} dofs, {steps}{self.seconds:.2g} s, "
            f"{self.memory / 1e6:.2g} MB"
        )


@dataclass(frozen=True)
class LevelChanges:
    """By which factors the next level differs from the last one; 1: not at all.

    Attributes
    ----------
    refinement : float
        The cells are smaller.
    shorter : float
        The steps are shorter.
    stiffer : float
        The penalties are stiffer.
    """

    refinement: float
    shorter: float
    stiffer: float


@dataclass
class LevelRow:
    """One level.

    Attributes
    ----------
    element, degree, cells, dofs : str, int, int, int
        The discretisation: the element and the degree of its displacement.
    seconds : float
        Elapsed seconds of the last load step and of the estimate, without compilation.
    elapsed : float
        Seconds since the start of the first level.
    fineness : float
        A number to which the size of the cells is inverse.
    steps : int
        The steps of a path on which the end depends; 0 without one.
    kind : str
        What they are: "time" or "load".
    estimate : Estimate
        The errors.
    goals : dict of GoalError
        The goals that count, with bounds from the second level on; empty if one has no estimate.
    reason : str
        Why one has none.
    steps_fail : bool
        Whether that is as steps fail.
    left : float or None
        The part of the last level's errors that these cells leave where the solution is smooth;
        None: that of cells of one size.
    gives_way : str
        The note that supports without an area carry a force: finer meshes have another answer.
    """

    element: str
    degree: int
    cells: int
    dofs: int
    seconds: float = 0.0
    elapsed: float = 0.0
    fineness: float = 1.0
    steps: int = 0
    kind: str = "time"
    estimate: Estimate = field(default_factory=Estimate)
    goals: dict[str, GoalError] = field(default_factory=dict)
    reason: str = ""
    steps_fail: bool = False
    left: float | None = None
    gives_way: str = ""


class Levels:
    """The levels so far, and the decisions that follow from them.

    Parameters
    ----------
    asked : float
        The relative error that is asked for.
    limits : mapping, optional
        ``max_time`` [s], ``max_memory`` [MB], ``max_dofs``; None or missing: none.
    dim : int, optional
        Dimension of the mesh.
    named : bool, optional
        Whether the goals were asked for by name: then all of them need an estimate. Otherwise
        forces of contact do not count while nothing touches, and the errors of forces below a tenth
        of the largest one are relative to that.
    """

    def __init__(
        self,
        asked: float,
        limits: Mapping[str, float | None] | None = None,
        dim: int = 3,
        named: bool = False,
    ) -> None:
        self.asked, self.dim, self.named = asked, dim, named
        self.rows: list[LevelRow] = []
        self._limits = {key: inf if v is None else v for key, v in (limits or {}).items()}
        #: Why the levels end before the request is met.
        self.limit = ""

    def add(self, row: LevelRow, estimate: Estimate | None) -> None:
        """Add a level with its estimate, which `measure` has given bounds."""
        row.estimate = estimate = estimate or Estimate(reason="the load steps did not converge")
        untouched = self._untouched(row)
        known = {name: g for name, g in estimate.goals.items() if vector_of(name) not in untouched}
        unknown = [name for name, goal in known.items() if goal.estimate is None]
        if estimate.reason:
            row.reason, row.steps_fail = estimate.reason, estimate.steps_too_long
        elif unknown:
            reasons = [f"{name}: {known[name].reason}" for name in unknown if known[name].reason]
            row.reason = reasons[0] if reasons else f"no estimate of {', '.join(unknown)}"
        else:
            row.goals = known
        self.rows.append(row)

    def measure(
        self, row: LevelRow, estimate: Estimate, unmeasured: Mapping[str, float] = {}
    ) -> None:
        """Add to an estimate the bounds that it and the levels so far, on larger cells, measure.

        ``unmeasured`` is that of `with_bounds`. `add` is to follow.
        """
        coarser = [before for before in self.rows if before.dofs < row.dofs]
        goals = [before.goals for before in coarser]
        left = self._left_by(row, coarser)
        estimate.goals = with_bounds(estimate.goals, goals, left, unmeasured)
        if not self.named:
            estimate.goals = with_scales_of_forces(estimate.goals)

    def _left_by(self, row: LevelRow, coarser: Sequence[LevelRow]) -> float:
        """Return the part of the errors that a level leaves of the coarser one, if smooth."""
        if not coarser:
            return 1.0
        if row.left is not None and coarser[-1] is self.rows[-1]:
            return row.left
        return left_by_uniform(coarser[-1].dofs, row.dofs, row.degree, self.dim)

    def _untouched(self, row: LevelRow) -> dict[str, str]:
        """Return the lines of forces of contact that do not count: see `Estimate.untouched`."""
        return {} if self.named else row.estimate.untouched

    @property
    def asked_goals(self) -> dict[str, GoalError]:
        """The goals of the last level that were asked for; empty without an estimate."""
        goals = self.rows[-1].goals if self.rows else {}
        return {name: goal for name, goal in goals.items() if goal.asked}

    @property
    def worst(self) -> tuple[str, float] | None:
        """The goal with the largest relative error on the last level; None without an estimate."""
        goals = self.asked_goals
        if not goals:
            return None
        name = max(goals, key=lambda name: goals[name].within)
        return name, goals[name].within

    @property
    def reached(self) -> bool:
        """Whether every goal of the last level is within the request."""
        worst = self.worst
        return worst is not None and worst[1] <= self.asked and not self.rows[-1].gives_way

    @property
    def futility(self) -> str:
        """Why a finer level would not meet the request either; "" if it may."""
        row = self.rows[-1]
        without = [not row.goals for row in self.rows[-_MOST_WITHOUT:]]
        if row.estimate.on_no_mesh or (len(without) == _MOST_WITHOUT and all(without)):
            return f"no estimate of the error: {row.reason}"
        return row.gives_way if self._has_bounds else ""  # without a limit

    def changes(self) -> LevelChanges:
        """Return how the next level differs from the last one."""
        refinement = 1.0 if self.mesh_suffices else self.refinement()
        shorter = self.shorter_steps()
        stiffer = self.stiffer_penalties(refinement, shorter)
        if max(refinement, shorter, stiffer) == 1:  # no part is what the bound is of
            refinement = self.refinement()
        return LevelChanges(refinement, shorter, stiffer)

    def refinement(self) -> float:
        """Return the factor by which the cells of the next level are to be smaller."""
        if self.worst is None:
            return _MOST_REFINEMENT
        if not self._has_bounds:
            return _TO_MEASURE[self.dim]
        factor = (self._excess_of_mesh / _AIM) ** (1 / self._order)
        least = _LEAST_REFINEMENT if self._is_confirmed else _TO_MEASURE[self.dim]
        return float(min(max(factor, least), _MOST_REFINEMENT))

    @property
    def _order(self) -> float:
        """The order in the size of cells with which estimates of the mesh decrease, measured.

        It is from 1, as at a crack, to 2p of smooth solutions; between them if cells are the same.
        """
        last, highest = self.rows[-1], 2.0 * self.rows[-1].degree
        before = next((r for r in self.rows[::-1] if r.goals and r.dofs < last.dofs), last)
        finer = log(last.dofs / before.dofs) / self.dim
        sizes = []
        for row in (before, last):
            goals = [goal for goal in row.goals.values() if goal.asked and goal.scale > 0]
            sizes.append(max((abs(goal.of_mesh) / goal.scale for goal in goals), default=0.0))
        if not finer or min(sizes) <= 0:
            return last.degree
        return min(max(log(sizes[0] / sizes[1]) / finer, 1.0), highest)

    @property
    def _excess_of_mesh(self) -> float:
        """The errors of the mesh over the request; 1 without bounds."""
        return self._excess("mesh") if self._has_bounds else 1.0

    @property
    def _has_bounds(self) -> bool:
        """Whether the goals of the last level have bounds."""
        return self.worst is not None and self.worst[1] < inf

    @property
    def _is_confirmed(self) -> bool:
        """Whether the goals have bounds, and the estimates of those not within are confirmed."""
        goals = self.asked_goals.values()
        return self._has_bounds and all(g.confirmed or g.within <= self.asked for g in goals)

    @property
    def left_of_errors(self) -> float:
        """The part of the errors of the mesh that the next level may leave; 0 to measure them."""
        if not self._is_confirmed:
            return 0.0
        return _AIM / excess if (excess := self._excess_of_mesh) > 0 else 1.0

    def shorter_steps(self) -> float:
        """Return the factor by which the steps of the next level are to be shorter."""
        if self.rows[-1].steps_fail:
            return _MOST_SHORTER
        factors = [self._factor(source, 1 / p, _MOST_SHORTER) for source, p in _STEPS.items()]
        if self.rows[-1].steps and self.rows[-1].kind == "time":  # see `stiffer_penalties`
            factors.append(self._factor("penalty", 0.5, _MOST_SHORTER))
        return max(factors)

    def stiffer_penalties(self, refinement: float = 1.0, shorter: float = 1.0) -> float:
        """Return the factor by which the penalties of the next level are to be stiffer.

        In time, time steps have to resolve their vibration: its frequency is the root of their
        stiffness over the size of the cells, which the default stiffness is inverse to.
        """
        factor = self._factor("penalty", 1.0, _MOST_STIFFER)
        if self.rows[-1].steps and self.rows[-1].kind == "time":
            return min(factor, max(1.0, (shorter / refinement) ** 2))
        return factor

    def _factor(self, source: str, power: float, most: float) -> float:
        """Return the factor that reduces a part of the errors to its share; 1 if that suffices."""
        if self._suffices(source):
            return 1.0
        return float(min(max(self._excess(source) ** power, _LEAST_REFINEMENT), most))

    @property
    def mesh_suffices(self) -> bool:
        """Whether the error of the mesh is within its share, and another part is not."""
        if self.rows[-1].steps_fail:
            return True
        return (
            self._has_bounds
            and self._suffices("mesh")
            and not all(map(self._suffices, self._parts))
        )

    @property
    def _parts(self) -> set[str]:
        """The parts of the errors of the last level: of the mesh, and perhaps others."""
        parts = (goal.parts.keys() for goal in self.asked_goals.values())
        return {"mesh"}.union(*parts)

    def _excess(self, source: str) -> float:
        """Return the largest contribution of a part to a bound, over its share of the request."""
        parts = (goal.contribution(source) for goal in self.asked_goals.values())
        return max(parts, default=0.0) * len(self._parts) / self.asked

    def _suffices(self, source: str) -> bool:
        """Return whether a part is within its share: an equal part of the request."""
        return self._excess(source) <= 1

    def forecast(
        self, refinement: float, shorter: float = 1.0, dofs: int = 0, cells: int = 0
    ) -> Forecast:
        """Return what a level with cells and steps so many times smaller will cost.

        ``dofs`` and ``cells`` are their numbers if its mesh is known.
        """
        last, power = self.rows[-1], float(self.dim)
        if len(self.rows) > 1 and (before := self.rows[-2]).fineness < last.fineness:
            power = log(last.cells / before.cells) / log(last.fineness / before.fineness)
        growth = max(1.0, dofs / last.dofs) if dofs else refinement**power
        seconds = last.seconds * growth**_TIME_POWER * shorter
        cells, dofs = cells or round(last.cells * growth), dofs or round(last.dofs * growth)
        steps = f"{ceil(last.steps * shorter):,} {last.kind} steps" if last.steps else ""
        return Forecast(cells, dofs, seconds, last.estimate.memory * growth, steps)

    def exceeds(self, forecast: Forecast, elapsed: float, available: float) -> str:
        """Return why the next level is not solved; empty if it is.

        Parameters
        ----------
        forecast : Forecast
            What it will cost.
        elapsed : float
            Seconds so far.
        available : float
            Memory that is available [bytes].
        """
        limits, memory, reason = self._limits, forecast.memory / 1e6, ""
        if forecast.dofs > limits.get("max_dofs", inf):
            reason = f"max_dofs = {limits['max_dofs']:,.0f}"
        elif elapsed + forecast.seconds > limits.get("max_time", inf):
            reason = f"max_time = {limits['max_time']:g} s, of which {elapsed:.2g} s have passed"
        elif memory > limits.get("max_memory", inf):
            reason = f"max_memory = {limits['max_memory']:g} MB"
        elif forecast.memory > available:
            reason = f"{available / 1e6:.2g} MB are available"
        return reason and f"{reason}: the next level has {forecast}"

    def overrun(self, elapsed: float) -> str:
        """Return why a level is not finished, from the seconds so far; empty if it may be."""
        limit = self._limits.get("max_time", inf)
        over = elapsed > _OVERRUN * limit
        return f"max_time = {limit:g} s, of which {elapsed:.3g} s have passed" if over else ""

    def cell_weights(self, cells: int, of_all: bool = False) -> Array:
        """Return the errors of cells over the request, of goals not within it, or ``of_all``."""
        row, weights = self.rows[-1], np.zeros(cells)
        for name, goal in self.asked_goals.items():
            wanted = of_all or not goal.within <= self.asked
            if wanted and name in row.estimate.indicators and goal.scale > 0:
                weights += np.abs(row.estimate.indicators[name]) / (self.asked * goal.scale)
        return weights

    def lines(self) -> list[str]:
        """Return the rows of the last level to print: a head, and a line for each goal."""
        row, asked = self.rows[-1], self.asked
        head = f"level {len(self.rows)}: {row.cells:,} {row.element} cells, {row.dofs:,} dofs"
        head += f", {row.steps:,} {row.kind} steps" if row.steps else ""
        if not row.goals:
            return [f"{head}: no estimate: {row.reason}"]
        head += f", {row.elapsed:.2g} s: "
        if not self._has_bounds:
            head += "estimates, which another level measures"
        else:
            counts = sum(goal.within <= asked for goal in self.asked_goals.values())
            head += f"{counts} of {len(self.asked_goals)} "
            head += f"{'bounds' if row.gives_way else 'goals'} within {100 * asked:g} %"
        shown = {name: goal for name, goal in self.asked_goals.items() if not goal.is_zero}
        label = row.estimate.label
        lines = [head, *(goal.line(label(name), asked) for name, goal in shown.items())]
        further = (*self._untouched(row).values(), *row.estimate.remarks)
        return [*lines, *(f"  {text}" for text in further)]

    def record(self) -> dict[str, Any]:
        """Return the entry ``accuracy`` of run.json."""
        last = self.rows[-1] if self.rows else LevelRow("", 1, 0, 0)
        at = {n: load for n, load in last.estimate.loads.items() if n in last.estimate.asked}
        return {
            "within": self.asked,
            "reached": self.reached,
            "limit": self.limit or None,
            "worst": self.worst[0] if self.worst else None,
            "relative": self.worst[1] if self.worst and self.worst[1] < inf else None,
            "without_contact": list(self._untouched(last)),
            "left_out": last.estimate.left_out if last.goals else [],
            **({"at": at} if at else {}),
            "small": [name for name, goal in self.asked_goals.items() if goal.small],
            "levels": [
                {
                    "element": row.element,
                    "cells": row.cells,
                    "dofs": row.dofs,
                    **({f"{row.kind}_steps": row.steps} if row.steps else {}),
                    "seconds": row.elapsed,
                    "reason": row.reason or None,
                    "goals": {n: g.record() for n, g in row.goals.items() if g.asked},
                }
                for row in self.rows
            ],
        }
