"""Terms with memory: what they keep from step to step, and the lagged quantities of a solve."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from itertools import count
from math import inf, isnan
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

import numpy.typing as npt

from fem_snh.errors import NotSettled
from fem_snh.terms.term import Term, WorkingTerm

Array = npt.NDArray[Any]

#: Solves of a step after which lagged quantities that still change make it fail. Lagged friction
#: converges linearly, by factors of 2 to 10 a solve, and augmentations leave E/(k h) of the gap;
#: what has not settled then alternates, or cannot: nodes that are constrained cannot follow.
MAX_SOLVES = 51

#: Solves of a step after which it fails, if none of them has reduced the largest change below what
#: it had been before: pairs of an unstable state alternate. In the tests of contact and friction
#: quantities that settle have at most two such solves in turn.
MAX_STALLED = 10


def relative(change: float, size: float, tolerance: float) -> float:
    """Return ``change / (tolerance size)``: 0 without a change, infinity without a size."""
    if change == 0:
        return 0.0
    return float(change / (tolerance * size)) if size > 0 else inf


class LaggedChange(NamedTuple):
    """The change of a term's lagged quantities after a solve.

    Attributes
    ----------
    ratio : float
        The change over its tolerance: above 1 the step is solved again.
    what : str
        What changes, for the reason of a failure.
    slid_off : bool
        Whether points that touched are beside the edge of the other surface now.
    """

    ratio: float = 0.0
    what: str = ""
    slid_off: bool = False

    @property
    def settled(self) -> bool:
        """Whether the change is below its tolerance; NaN is not."""
        return self.ratio <= 1


def largest_change(changes: Iterable[LaggedChange]) -> LaggedChange:
    """Return the largest of some changes, or NaN if one is; without any, no change."""
    return max(changes, key=lambda change: (isnan(change.ratio), change), default=LaggedChange())


class HistoryTerm(Term):
    """A term with quantities that are constant during a solve: multipliers, lagged friction.

    ``u`` is the ghosted displacement. All methods are collective.
    """

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset lagged quantities to those of the last accepted step, whose displacement is u.

        It is called before each attempt of a step, so also after one that failed.
        """
        raise NotImplementedError(f"{type(self).__name__}.begin_step")

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Update lagged quantities after a converged solve; return their change.

        The result is the same on all ranks.
        """
        raise NotImplementedError(f"{type(self).__name__}.update_lagged")

    def end_step(self, u: PETSc.Vec) -> None:
        """Keep the present quantities: the step is accepted."""
        raise NotImplementedError(f"{type(self).__name__}.end_step")

    def history(self) -> tuple[Array, Array]:
        """Return this rank's (n, 3) reference coordinates [m] and (n, k) kept values there."""
        raise NotImplementedError(f"{type(self).__name__}.history")

    def set_history(self, values: Array) -> None:
        """Set the kept values, (n, k), in the order of `history`."""
        raise NotImplementedError(f"{type(self).__name__}.set_history")


class TermHistory:
    """The history of a problem's terms. All methods are collective.

    Parameters
    ----------
    terms : sequence of Term
        The problem's terms.

    Attributes
    ----------
    solves : int
        How often the present step was solved.
    change : LaggedChange
        The largest change of lagged quantities after the last solve.
    """

    def __init__(self, terms: Sequence[Term]) -> None:
        self._terms = [term for term in terms if isinstance(term, HistoryTerm)]
        self._working = [term for term in terms if isinstance(term, WorkingTerm)]
        self._all = list(terms)
        self._reset()

    def _reset(self) -> None:
        self.solves, self.change = 0, LaggedChange()
        self._least, self._stalled = inf, 0  # the least change so far, and solves since then

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset the terms to the last accepted step, whose displacement is ``u``."""
        self._reset()
        for term in self._terms:
            term.begin_step(u)

    def update_lagged(self, u: PETSc.Vec) -> bool:
        """Update lagged quantities after a solve; return whether the step is solved again.

        Raises
        ------
        NotSettled
            On every rank, if they still change after MAX_SOLVES solves, or if the change has not
            become smaller for MAX_STALLED solves.
        """
        self.solves += 1
        self.change = change = largest_change([term.update_lagged(u) for term in self._terms])
        self._stalled = 0 if change.ratio < self._least else self._stalled + 1
        self._least = min(self._least, change.ratio)
        if change.settled:
            self._least, self._stalled = inf, 0
            return False
        alternates = self._stalled >= MAX_STALLED
        if alternates or self.solves >= MAX_SOLVES:
            times = f"{change.ratio:.3g} times the tolerance after {self.solves} solves"
            least = f", and never less than {self._least:.3g} times" if alternates else ""
            raise NotSettled(f"{change.what} is {times}{least}")
        return True

    def settling(self) -> dict[str, Any]:
        """Return what a step's row of run.json says of terms with a history.

        ``solves``, how often the step was solved, and ``lagged_change``, how much that last
        changed lagged quantities, in their tolerance.
        """
        if not self._terms:
            return {}
        return {"solves": self.solves, "lagged_change": self.change.ratio}

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return the sums of the terms' work and dissipation in a step: see `WorkingTerm`."""
        found = [term.step_work(u, end_weight) for term in self._working]
        return sum(work for work, _ in found), sum(lost for _, lost in found)

    def end_step(self, u: PETSc.Vec) -> None:
        """Keep the present quantities of the terms: the step is accepted."""
        for term in self._terms:
            term.end_step(u)

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return what the terms add to the step's row of run.json.

        The second row of one name under a key is called ``name_2``.
        """
        found: dict[str, dict[str, Any]] = {}
        for term in self._all:
            for key, rows in term.record(u).items():
                table = found.setdefault(key, {})
                for name, row in rows.items():
                    table[_unused(name, table)] = row
        return found

    def is_kept(self, comm: MPI.Intracomm) -> bool:
        """Return whether terms keep something from step to step, such as friction."""
        return any([comm.allreduce(term.history()[1].size) > 0 for term in self._terms])

    @property
    def by_name(self) -> dict[str, HistoryTerm]:
        """The terms with a history, by name, for the checkpoint: the second is ``name_2``."""
        found: dict[str, HistoryTerm] = {}
        for term in self._terms:
            found[_unused(term.name, found)] = term
        return found


def _unused(name: str, taken: Container[str]) -> str:
    """Return the name, or the first of name_2, name_3, ... that is not taken."""
    return next(n for k in count(1) if (n := name if k == 1 else f"{name}_{k}") not in taken)
