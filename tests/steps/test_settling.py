"""The solves of a step end: lagged quantities settle, alternate, or change for too long."""

from __future__ import annotations

from itertools import cycle

import pytest

from fem_snh.errors import NotSettled
from fem_snh.terms.history import MAX_SOLVES, MAX_STALLED, HistoryTerm, LaggedChange, TermHistory


def changing(ratios):
    """Return the history of a term whose changes are these ratios, in a step that has begun."""
    left = iter(ratios)

    class Pairs(HistoryTerm):
        name = "pairs"
        begin_step = end_step = history = set_history = lambda *_: None

        def update_lagged(self, u):
            return LaggedChange(next(left), "pairs")

    history = TermHistory([Pairs()])
    history.begin_step(None)
    return history


def solves(history):
    """Solve a step until it has settled; return how often it was solved."""
    while history.update_lagged(None):
        pass
    return history.solves


def test_pairs_that_alternate_end_the_step():
    """The smallest change, of the second solve, is not undercut by ten further ones."""
    history = changing(cycle([20.0, 4.0, 7.0]))
    with pytest.raises(NotSettled, match=r"^pairs is 7 times the tolerance after 12 solves, .*4"):
        solves(history)
    assert history.solves == 2 + MAX_STALLED


def test_what_decreases_slowly_settles_or_ends_after_all_solves():
    assert solves(changing(20 * 0.9**k for k in range(100))) == 30  # 20 * 0.9^29 < 1
    history = changing(1 + 20 * 0.9**k for k in range(100))
    with pytest.raises(NotSettled, match=f"after {MAX_SOLVES} solves$"):
        solves(history)


def test_a_further_solve_of_a_settled_step_is_not_compared_with_those_before():
    """An estimate solves on in the same step, to another state."""
    history = changing([0.1, *range(30, 0, -1)])
    assert not history.update_lagged(None)
    assert solves(history) == 1 + 30
