"""Errors of a table, the Pareto front, and advice."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from tradeoff_rows import OF, assessed, by_hand, row

from benchmarks import tradeoff_tables
from fem_snh.errors import BadInput
from fem_snh.studies.tradeoff import advice, errors


def test_errors_are_of_what_converged_against_the_finest() -> None:
    lines: list[str] = []
    table = errors.assess(by_hand(), OF, lines.append)
    q1 = table[table["element"] == "Q1"]["error_displacement"]
    assert q1.tolist() == pytest.approx([0.5, 0.25, 0.125], rel=1e-3)
    assert table["error_energy"][0] == pytest.approx(0.5, rel=1e-3)
    assert np.isnan(table["error_displacement"].iloc[-1])  # that did not converge
    assert table["shift"].iloc[-2] == pytest.approx(1e-5, rel=1e-2)
    assert table["shift"][0] == 0
    by_quantity = {line.partition(":")[0]: line for line in lines}
    assert "order 3.00" in by_quantity["energy"] and "Q2Q1 up to 16 cells" in by_quantity["energy"]
    assert "rejected" in by_quantity["volume"] and table["error_volume"].isna().all()
    assert "reaction" not in by_quantity


def test_without_three_meshes_there_is_no_error() -> None:
    table = by_hand().iloc[:5]
    found = errors.assess(table, OF, lambda line: None)
    assert found["error_displacement"].isna().all()
    assert list(advice.sentences(found)) == [
        "hand, nu = 0.3: no reference that is accurate enough, no recommendation"
    ]
    assert advice.advice(found).empty


@given(st.lists(st.tuples(st.integers(1, 9), st.integers(1, 9)), min_size=1, max_size=20))
def test_nothing_beats_the_front(pairs: list[tuple[int, int]]) -> None:
    rows = pd.DataFrame(pairs, columns=["cpu", "error"], dtype=float)
    kept = advice.pareto_front(rows)
    assert kept["cpu"].is_monotonic_increasing and kept["error"].is_monotonic_decreasing
    for cpu, error in pairs:
        assert ((kept["cpu"] <= cpu) & (kept["error"] <= error)).any()
    for _, best in kept.iterrows():
        better = (rows["cpu"] <= best["cpu"]) & (rows["error"] <= best["error"])
        assert not (better & (rows[["cpu", "error"]] != best[["cpu", "error"]]).any(axis=1)).any()


def test_advice_in_words() -> None:
    five, one, tenth = advice.sentences(assessed(), (0.2, 0.01, 1e-9))
    assert five.startswith("hand, nu = 0.3, 20 % of displacement: use Q2Q1, 2 cells: ")
    assert "0.08 s, 1.2 times the cheapest; Q1 takes 51 times that" in five
    assert "Q1 does not reach it: 16 cells, 51 times that, 13 %" in one
    assert "unknown, the reference resolves errors above" in tenth
    lines = advice.by_element(assessed(), (0.2,))
    assert [line[:3] for line in lines] == [
        ["0.3", "Q1", "4.1 s (16 cells)"], ["0.3", "Q2Q1", "0.08 s (2 cells)"]
    ]  # fmt: skip


def test_a_page_is_filled_from_its_tables() -> None:
    table = assessed()
    kinds = {kind: tradeoff_tables.TABLES[kind](table) for kind in tradeoff_tables.TABLES}
    assert "| Q1 | 8 | 512 | 25 % |" in kinds["locking"]
    assert "| Q1 | 5 % | never |\n" in kinds["price"]
    assert "| Q2Q1 | 5 % | 0.08 (2) |\n" in kinds["price"]
    assert "| Q2Q1 | 8 | 1 |" in kinds["iterations"]
    assert "| 0.3 | Q2Q1 | 4 | clamp | 1 | 1 | x 1.6 | 1e-05 |" in kinds["knobs"]
    assert "| 0.3 | Q2Q1 | 4 |  | 1, x 1.6 |  |  | 1, x 1 |" in kinds["filters"]
    text = "a\n<!-- table: hand price -->\nold\n<!-- end -->\nb\n"
    filled = tradeoff_tables.fill(text, {"hand": table})
    assert (
        filled
        == text.replace("old", kinds["price"])
        == tradeoff_tables.fill(filled, {"hand": table})
    )
    for wrong in ("hans price", "hand prize"):
        with pytest.raises(BadInput, match=r"did you mean '(hand|price)'"):
            tradeoff_tables.fill(text.replace("hand price", wrong), {"hand": table})


def test_the_bound_contains_the_error_of_the_reference() -> None:
    """Values that converge to 1, with orders mixed so that the extrapolated reference is off.

    With the distance to the reference alone, the bound of some row is below its true error.
    """
    rows = [row("Q1", n, 1 - 0.4 / n) for n in (4, 8, 16)]
    rows += [row("Q2Q1", n, 1 - 0.2 / n - 0.3 / n**3) for n in (2, 4, 8, 16)]
    table = errors.assess(pd.DataFrame(rows), OF, lambda line: None)
    true = abs(table["p.x"] - 1)
    known = table["error_displacement"].notna()
    assert known.sum() == len(rows)
    bounds = pd.Series([errors.error_bound(line) for line in table.to_dict("records")])
    assert (bounds >= true).all()
    without = np.maximum(table["error_displacement"], table["floor_displacement"])
    assert (without < true).any()
    own = table["floor_displacement"] / 10
    measured = table["error_displacement"] >= table["floor_displacement"]
    expected = (table["error_displacement"] + own) / (1 - own)
    assert bounds[measured].tolist() == pytest.approx(expected[measured].tolist(), rel=1e-12)
