"""Detect steps whose end depends on their size: jumps to a state far away, and skipped paths.

A step that moves the body several times as far as its first guess is suspicious. The step is then
solved again to its middle, and to the middle of the half in which the body moves farther, and so
on. On a path of equilibria an eighth of the load step causes about an eighth of the motion. Where a
state ceases to exist, one short part has most of the motion, however short it is. Further halvings
tell a jump from a steep but continuous motion, as of a sheet pressed to a hundredth of its height.

A step that loses energy is divided in the same way, by its loss: a fold that snaps need not move
the body far. Along a path of equilibria the energy changes by the work of boundary values and
loads.

If a part of the step fails although the whole step converged, a note says that the path is lost.
Terms that keep a history do not allow trial steps: steps with many iterations or large motions are
then noted.

A step that ends far from its first guess may have passed a bifurcation, beyond which there are
several stable states. (Without a first guess, the motion of the step before is continued.) Small
problems are solved again in parts of the step. If the last part ends with another energy, the step
has skipped the path.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np

from fem_snh import solver
from fem_snh.errors import NotSettled
from fem_snh.problem.problem import Problem
from fem_snh.records.run_record import Note

#: Largest residual of an equilibrium over the largest force of a term: solves leave 1e-4.
_BALANCED = 1e-2
#: Ratio of a step's displacement to the expected one above which the step is examined.
_FAR = 3.0
#: The same ratio above which a step that cannot be examined is noted: a body that begins to slide
#: or to touch moves a few times as far.
_VERY_FAR = 10.0
#: A step of this many times the median Newton iterations of the steps before is suspicious; the
#: least median counted: an easy step takes 2, a step with contact up to 50.
_MANY, _LEAST_USUAL = 10, 5
#: Ignore an expected displacement below this part of the actual one: it is rounding, as the first
#: guess was the state before the step (no predictor, or the start from a coarser mesh).
_NONE = 1e-9
#: Number of halvings of a suspicious step.
_HALVINGS = 3
#: A part of 1/2^_HALVINGS of the step's load may be a jump if it has more than _MOST of the step's
#: displacement; it is a jump if it still has after _FURTHER halvings, or after a halving that keeps
#: _KEPT of it.
_MOST, _FURTHER, _KEPT = 0.5, 4, 0.97
#: Distance from the first guess to the end, over the step's displacement, from which the path is
#: followed again (0.1 to 0.3 in the built-in scenes, 0.97 to 1.2 where a body buckles): in _PARTS
#: parts, each halved _HALVED times at most, in problems of at most _MAX_NODES nodes.
_OFF, _PARTS, _HALVED, _MAX_NODES = 0.6, 4, 6, 5_000
#: Relative difference of energies from which states differ. Mirror images have the same energy;
#: cells that are inverted in one of two states change it by a thousandth.
_DIFFERENT = 1e-2
#: Lost energy of a step, over its work, from which the step is examined. The trapezoidal rule gives
#: the work along a path; each halving reduces its error to an eighth.
_LOSS = 0.25
#: A part of 1/2^_HALVINGS of the load may be a jump if it has this part of the loss: the error
#: along a path is (1/8)^_HALVINGS there.
_LOST_PART = 1 / 8
#: Part of the load step by which the rate of work is differenced.
_DIFFERENCE = 1e-3
#: Difference of energies over E V that solver tolerances leave: that of strains of 1e-6. A residual
#: of 1e-7 E V^(2/3) leaves strains of 1e-7, and more near an instability.
_UNKNOWN = 1e-12


class Jump(NamedTuple):
    """A jump of the body.

    Attributes
    ----------
    start, end : float
        Loads between which the body jumps.
    part : float
        Part of the step's displacement, or with ``lost`` of its lost energy, between these loads.
    ratio : float
        The step's displacement over the expected displacement; 0 if that is unknown.
    lost : float
        The energy that the step loses [J]; 0 if the jump was found by displacement.
    """

    start: float
    end: float
    part: float
    ratio: float
    lost: float = 0.0


class LostPath(NamedTuple):
    """A suspicious step of which a smaller part finds no equilibrium.

    Attributes
    ----------
    start, end : float
        Loads between which the path is lost.
    part, ratio : float
        See `Jump`.
    """

    start: float
    end: float
    part: float
    ratio: float


class UnexaminedStep(NamedTuple):
    """A step with a large motion or many iterations that cannot be solved again.

    Attributes
    ----------
    start, end : float
        Loads of the step.
    ratio : float
        As for `Jump`.
    newton : int
        Newton iterations of the step.
    usual : float
        Median of the Newton iterations of the steps before; 0 in the first step.
    """

    start: float
    end: float
    ratio: float
    newton: int
    usual: float


class SkippedPath(NamedTuple):
    """A step that ends in another state than the same path in smaller steps.

    Attributes
    ----------
    start, end : float
        Loads of the step.
    energy : float
        Energy [J] of the step's end.
    followed : float
        Energy [J] at the end of the smaller steps.
    """

    start: float
    end: float
    energy: float
    followed: float


#: A load, and the unknowns there.
State = tuple[float, PETSc.Vec]
#: How to reach the states that a load jumps over.
BEYOND_LIMIT = (
    "those between need a prescribed displacement ([[move]]) in place of the load, the volume of a "
    "[[cavity]] in place of a pressure, or a motion in time"
)
#: What `JumpDetector.find` may find in a step.
Finding = Jump | LostPath | UnexaminedStep | SkippedPath


class JumpDetector:
    """Examines each load step of a static problem for jumps. All methods are collective.

    If a term keeps a history, steps are not solved again, as that would change the history.

    Parameters
    ----------
    problem : Problem
        The problem.
    snes : PETSc.SNES
        The problem's solver.
    """

    def __init__(self, problem: Problem, snes: PETSc.SNES) -> None:
        self._problem, self._snes = problem, snes
        #: The last step's change of the unknowns per load, and its norm in free displacements [m].
        self._motion: PETSc.Vec | None = None
        self._rate = 0.0
        self._guess: PETSc.Vec | None = None
        #: Newton iterations of the steps before.
        self._newton: list[int] = []
        #: The solves by which the last step was examined.
        self._examined = solver.StepOutcome()

    @staticmethod
    def of(problem: Problem, snes: PETSc.SNES) -> JumpDetector | None:
        """Return the detector of a problem; None without loads."""
        return JumpDetector(problem, snes) if problem.depends_on_load else None

    def begin(self) -> None:
        """Keep the present unknowns, the first guess of the step."""
        self._guess = self._problem.x.copy()

    def find(self, load: float, start: PETSc.Vec, newton: int) -> Finding | None:
        """Examine the step from ``load`` and unknowns ``start`` to the problem's present state.

        ``newton`` are its Newton iterations. Return the finding, or None. The state is restored.
        """
        problem, guess = self._problem, self._guess
        self._examined = solver.StepOutcome()
        if guess is None:
            return None
        to, end, self._guess = problem.load, problem.x.copy(), None
        moved, step = self._distance(start, end), to - load
        guessed = self._distance(start, guess)
        expected = max(guessed, self._rate * step)
        if guessed <= _NONE * moved and self._motion is not None:
            guess = start + step * self._motion
        self._motion, self._rate = (end - start) / step, moved / step
        usual = float(np.median(self._newton)) if self._newton else 0.0
        self._newton.append(newton)
        is_slow = usual > 0 and newton >= _MANY * max(usual, _LEAST_USUAL)
        is_known = _NONE * moved < _FAR * expected
        ratio = moved / expected if is_known else 0.0
        if problem.history.by_name:
            noted = is_slow or ratio > _VERY_FAR
            return UnexaminedStep(load, to, ratio, newton, usual) if noted else None
        low, high = (load, start), (to, end)
        lost, work = self._lost(low, high)
        self._restore(to, end)
        loses = moved > 0 and lost > max(_LOSS * work, self._unknown_energy)
        is_suspicious = ratio > _FAR or (is_slow and moved > 0) or loses
        if not is_suspicious and (not is_known or self._distance(guess, end) <= _OFF * moved):
            return None
        found: Finding | None = None
        self._restore(load, start)
        is_path = is_balanced(problem)
        if is_path and (ratio > _FAR or (is_slow and moved > 0)):
            found = self._bisect(low, high, lambda a, b: self._distance(a[1], b[1]), _MOST)
            found = found and found._replace(ratio=ratio)
        if is_path and found is None and loses:
            found = self._bisect(low, high, lambda a, b: self._lost(a, b)[0], _LOST_PART)
            if isinstance(found, Jump):
                found = found._replace(ratio=ratio, lost=lost)
        self._restore(to, end)
        if is_path and found is None and ratio <= _FAR:
            found = self._compare(low, to)
            self._restore(to, end)
        return found

    def _restore(self, load: float, x: PETSc.Vec) -> None:
        """Set the problem's load and unknowns."""
        x.copy(self._problem.x)
        self._problem.set_load(load)
        self._problem.split(self._problem.x)

    def _compare(self, start: State, to: float) -> SkippedPath | None:
        """Follow the path from ``start`` to load ``to``; return how its end differs, or None.

        None also if the path fails, or is not followed. The problem's state changes.
        """
        problem = self._problem
        if problem.regime.nodes > _MAX_NODES or not problem.has_energy:
            return None
        energy, state = problem.energy(problem.x), start
        for part in range(1, _PARTS + 1):
            load = start[0] + (to - start[0]) * part / _PARTS
            following = self._follow(state, load, _HALVED)
            if following is None:
                return None
            state = following
        followed = problem.energy(state[1])
        different = _DIFFERENT * max(abs(energy), abs(followed))
        if abs(followed - energy) <= max(different, self._unknown_energy):
            return None
        return SkippedPath(start[0], to, energy, followed)

    @property
    def _unknown_energy(self) -> float:
        """The difference of energies [J] that solver tolerances leave."""
        return _UNKNOWN * self._problem.force_scale * self._problem.length

    def _lost(self, low: State, high: State) -> tuple[float, float]:
        """Return the lost energy and the absolute work [J] between two equilibria.

        The energy is that of body and loads; changes of boundary values and loads do work. Without
        an energy both are 0. The problem's state changes.
        """
        problem = self._problem
        if not problem.has_energy:
            return 0.0, 0.0
        step, energies, rates = high[0] - low[0], [], []
        for load, x in (low, high):
            for part in (0.0, -_DIFFERENCE, _DIFFERENCE):
                self._restore(load, x)
                problem.set_load(load + part * step)
                problem.prescribe(problem.x)
                energies.append(problem.energy(problem.x))
            rates.append((energies[-1] - energies[-2]) / (2 * _DIFFERENCE * step))
        work = step * sum(rates) / 2
        return work - (energies[3] - energies[0]), abs(work)

    def _follow(self, start: State, to: float, halvings: int) -> State | None:
        """Return the state at a load, by one or up to 2^``halvings`` solves; None if they fail."""
        found = self._solve(start, to)
        if found is not None or halvings == 0:
            return found
        middle = self._follow(start, (start[0] + to) / 2, halvings - 1)
        return middle and self._follow(middle, to, halvings - 1)

    def _bisect(
        self, low: State, high: State, measure: Callable[[State, State], float], most: float
    ) -> Jump | LostPath | None:
        """Bisect the step for a jump; return it, or the part where a solve fails, or None.

        ``measure(a, b)`` is the displacement or loss from state a to b. Around a jump it stays more
        than the part ``most`` of the step's.
        """
        found: Jump | None = None
        part, whole = 1.0, measure(low, high)
        for halvings in range(1, _HALVINGS + _FURTHER + 1):
            middle = self._solve(low, (low[0] + high[0]) / 2)
            if middle is None:
                return found or LostPath(low[0], high[0], part, 0.0)
            if measure(low, middle) > measure(middle, high):
                high = middle
            else:
                low = middle
            before, part = part, measure(low, high) / whole
            if halvings >= _HALVINGS and part <= most:
                return None
            if halvings == _HALVINGS:
                found = Jump(low[0], high[0], part, 0.0)
            elif halvings > _HALVINGS and part > _KEPT * before:
                break
        return found

    def _solve(self, start: State, to: float) -> State | None:
        """Solve from a state to a larger load; return the state there, None if that fails."""
        problem = self._problem
        self._restore(*start)
        outcome = self._examined
        try:
            outcome.predicted += solver.Predictor(problem, self._snes, "tangent").predict(to)
        except NotSettled:
            return None
        with solver.callback_errors():
            self._snes.solve(None, problem.x)
        outcome.add_solve(self._snes)
        return (to, problem.x.copy()) if outcome.converged else None

    def row(self) -> dict[str, int]:
        """Return the row's iterations of the solves that examined the last step, {} if none did."""
        found = self._examined
        if not found.history:
            return {}
        return {f"examined_{name}": getattr(found, name) for name in ("newton", "linear", "lbfgs")}

    def _distance(self, start: PETSc.Vec, end: PETSc.Vec) -> float:
        """Return the norm of the displacement [m] of the free dofs from one state to another."""
        moved = (end - start).array
        self._problem.project(moved)
        moved = moved[: self._problem.owned_displacements]
        return float(np.sqrt(self._problem.comm.allreduce(moved @ moved, op=MPI.SUM)))


def is_balanced(problem: Problem) -> bool:
    """Return whether the residual's norm is at most 1 % of `Problem.largest_force`. Collective."""
    residual = problem.x.duplicate()
    problem.residual(problem.x, residual)
    return residual.norm() <= _BALANCED * problem.largest_force(problem.x)


def start_notes(problem: Problem) -> list[Note]:
    """Return [], or a note if the present state is no equilibrium at the present load.

    `is_balanced` decides. A program calls it at load 0, before its first step. Collective.
    """
    if is_balanced(problem):
        return []
    text = (
        "the state at load 0 is no equilibrium, so the first step moves the body more than its "
        "load does: constants and functions of terms in UFL act in full in every step, unless "
        "set_load of steps(number, set_load) ramps them; or u is no solution"
    )
    return [Note("load", text)]


def jump_notes(found: Finding | None, step: int) -> list[Note]:
    """Return [], or the note on what was found in the attempted step number ``step``."""
    return [Note("jump", _description(found), step, found._asdict())] if found else []


def _description(found: Finding) -> str:
    loads = f"{found.start:.6g} to {found.end:.6g}"
    if isinstance(found, SkippedPath):
        return (
            f"the step from load {loads} ends at another equilibrium than {_PARTS} smaller ones: "
            f"its energy is {found.energy:.4g} J, theirs {found.followed:.4g} J; the body has "
            "several states there, and which one it reaches depends on the path: take more steps"
        )
    is_far = found.ratio > _FAR
    far = f"{found.ratio:.2g} times as far as expected"
    if isinstance(found, UnexaminedStep):
        usual = f", {found.usual:g} in the steps before" if found.usual else ""
        return (
            f"in the step from load {loads} the body moves{f' {far}' if is_far else ''} in "
            f"{found.newton} Newton iterations{usual}: it may have jumped to another state "
            "(snap-through, buckling, loss of contact), for which steps with contact or friction "
            f"are not examined; {BEYOND_LIMIT}"
        )
    lost = isinstance(found, LostPath)
    way = ", and half of that step finds no equilibrium: " if lost else ": "
    parts = "displacement of the step to its load are made"
    if isinstance(found, Jump) and found.lost:
        parts = f"{found.lost:.3g} J that the step to its load loses are lost"
    return (
        f"{100 * found.part:.0f} % of the {parts} between "
        f"the loads {found.start:.6g} and {found.end:.6g}{way}the body jumps to a state far away "
        f"(snap-through){f', {far}' if is_far else ''}; {BEYOND_LIMIT}"
    )
