"""The solves of a step end: lagged quantities settle, alternate, or change for too long."""

from __future__ import annotations

from itertools import cycle

import pytest

from fem_snh.errors import NotSettled
from fem_snh.terms.history import MAX_STALLED, HistoryTerm, LaggedChange, TermHistory


def test_pairs_that_alternate_end_the_step():
    """The smallest change, of the second solve, is not undercut by ten further ones."""
    left = cycle([20.0, 4.0, 7.0])

    class Pairs(HistoryTerm):
        name = "pairs"
        begin_step = end_step = history = set_history = lambda *_: None

        def update_lagged(self, u):
            return LaggedChange(next(left), "pairs")

    history = TermHistory([Pairs()])
    history.begin_step(None)
    with pytest.raises(NotSettled, match=r"^pairs is 7 times the tolerance after 12 solves, .*4"):
        while history.update_lagged(None):
            pass
    assert history.solves == 2 + MAX_STALLED


def test_terms_of_one_name_are_both_in_the_checkpoint():
    first, second = HistoryTerm(), HistoryTerm()
    assert TermHistory([first, second]).by_name == {"term": first, "term_2": second}
