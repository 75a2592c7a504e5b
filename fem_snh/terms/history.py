"""Terms with memory: values kept from step to step, and lagged quantities of a solve."""

from __future__ import annotations

from collections.abc import Container, Iterable, Sequence
from itertools import count
from math import inf, isnan
from typing import Any, NamedTuple

from mpi4py import MPI
from petsc4py import PETSc

from fem_snh.arrays import Array
from fem_snh.errors import NotSettled
from fem_snh.terms.term import Term, WorkingTerm

#: Solves of a step after which the step fails if lagged quantities still change. Lagged friction
#: converges linearly, by factors of 2 to 10 a solve, and augmentations leave E/(k h) of the gap.
#: Quantities that have not settled then alternate, or constrained nodes cannot follow them.
MAX_SOLVES = 51

#: Solves in turn without a new minimum of the largest change, after which a step fails: contact
#: pairs of an unstable state alternate. In the tests of contact and friction quantities that
#: settle have at most two such solves in turn.
MAX_STALLED = 10


#: Nodal contact forces have settled if they change by at most this fraction of the largest one.
SETTLED = 1e-2


def relative(change: float, size: float, tolerance: float) -> float:
    """Return ``change / (tolerance * size)``; 0 if change is 0, else infinity unless size > 0."""
    if change == 0:
        return 0.0
    return float(change / (tolerance * size)) if size > 0 else inf


class LaggedChange(NamedTuple):
    """The change of a term's lagged quantities after a solve; by default no change.

    Attributes
    ----------
    ratio : float
        The change over its tolerance: above 1 the step is solved again.
    what : str
        The quantity that changes, for the reason of a failure.
    slid_off : bool
        Whether points that were in contact have slid beyond the edge of the other surface.
    """

    ratio: float = 0.0
    what: str = ""
    slid_off: bool = False

    @property
    def settled(self) -> bool:
        """Whether the change is at most its tolerance; False for NaN."""
        return self.ratio <= 1


def largest_change(changes: Iterable[LaggedChange]) -> LaggedChange:
    """Return the change of largest ratio, or one whose ratio is NaN; without any, no change."""
    return max(changes, key=lambda change: (isnan(change.ratio), change), default=LaggedChange())


class HistoryTerm(Term):
    """A term with a history: quantities that `add_residual` and `energy` read but do not change.

    Lagged quantities, such as multipliers, are constant during a solve; `update_lagged` changes
    them, and the step is solved again until they settle. Internal variables of a material need no
    second solve: each evaluation computes them from u and their values in the last accepted step,
    `update_lagged` returns ``LaggedChange()``, and `end_step` stores the new values.

    ``u`` is the ghosted displacement. All methods are collective.
    """

    def begin_step(self, u: PETSc.Vec) -> None:
        """Reset lagged quantities to those of the last accepted step, whose displacement is u.

        It is called before each attempt of a step, also after a failed attempt.
        """
        raise NotImplementedError(f"{type(self).__name__}.begin_step")

    def update_lagged(self, u: PETSc.Vec) -> LaggedChange:
        """Update lagged quantities after a converged solve; return their change.

        The result is the same on all ranks.
        """
        raise NotImplementedError(f"{type(self).__name__}.update_lagged")

    def end_step(self, u: PETSc.Vec) -> None:
        """Store the history at ``u``: the step is accepted."""
        raise NotImplementedError(f"{type(self).__name__}.end_step")

    def history(self) -> tuple[Array, Array]:
        """Return this rank's reference points (n, 3) [m] and the kept values there (n, k).

        The values have size 0 if the term keeps nothing.
        """
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
        The number of solves of the present step.
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
        """Update lagged quantities after a solve; return whether to solve the step again.

        Raises
        ------
        NotSettled
            On every rank, if the quantities still change after MAX_SOLVES solves, or if their
            change has had no new minimum for MAX_STALLED solves.
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
        """Return keys of a step's row of run.json; none without terms with a history.

        ``solves`` is the number of solves of the step, and ``lagged_change`` the change of lagged
        quantities after the last solve over its tolerance.
        """
        if not self._terms:
            return {}
        return {"solves": self.solves, "lagged_change": self.change.ratio}

    def step_work(self, u: PETSc.Vec, end_weight: float) -> tuple[float, float]:
        """Return the sums of the terms' work and dissipation [J]: see `WorkingTerm.step_work`."""
        found = [term.step_work(u, end_weight) for term in self._working]
        return sum(work for work, _ in found), sum(lost for _, lost in found)

    def end_step(self, u: PETSc.Vec) -> None:
        """Store the history of the terms at ``u``: the step is accepted."""
        for term in self._terms:
            term.end_step(u)

    def record(self, u: PETSc.Vec) -> dict[str, dict[str, Any]]:
        """Return what all terms add to the step's row of run.json: see `Term.record`.

        If two terms have a row of the same name under one key, the second is called ``name_2``.
        """
        found: dict[str, dict[str, Any]] = {}
        for term in self._all:
            for key, rows in term.record(u).items():
                table = found.setdefault(key, {})
                for name, row in rows.items():
                    table[_unused(name, table)] = row
        return found

    def is_kept(self, comm: MPI.Intracomm) -> bool:
        """Return whether any term keeps values from step to step, such as the slip of friction."""
        return any([comm.allreduce(term.history()[1].size) > 0 for term in self._terms])

    @property
    def by_name(self) -> dict[str, HistoryTerm]:
        """The terms with a history by name; the second of one name is ``name_2``."""
        found: dict[str, HistoryTerm] = {}
        for term in self._terms:
            found[_unused(term.name, found)] = term
        return found


def _unused(name: str, taken: Container[str]) -> str:
    """Return the name, or the first of name_2, name_3, ... that is not taken."""
    return next(n for k in count(1) if (n := name if k == 1 else f"{name}_{k}") not in taken)
