"""Recommend settings: the Pareto front of cost and error, and the cheapest row for an accuracy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from fem_snh.assembly.elements import ELEMENTS
from fem_snh.studies.markdown import markdown_table
from fem_snh.studies.tradeoff.errors import error_bound
from fem_snh.studies.tradeoff.knobs import AUTOMATIC

#: Relative errors of the displacement for which settings are recommended.
ACCURACIES = (0.05, 0.01, 0.001)
#: Columns of advice.csv: the settings, and their cost.
CHOICE = (
    "element",
    "cells",
    "mesh",
    "hessian",
    "solver",
    "forcing",
    "tolerance",
    "steps",
)
COST = ("cpu", "seconds", "dofs", "newton", "linear", "peak_memory_mb")
COLUMNS = ("scene", "nu", *CHOICE, "error", "floor", *COST)


def rows_with_error(table: pd.DataFrame) -> pd.DataFrame:
    """Return the converged rows whose error is known, with its upper bound in ``error``."""
    if "error_displacement" not in table:
        return table.iloc[:0].assign(error=[], floor=[])
    good = table["converged"].astype(str).eq("True") & table["error_displacement"].notna()
    rows = table[good].copy()
    rows["error"] = [error_bound(row) for row in rows.to_dict("records")]
    rows["floor"] = rows["floor_displacement"]
    return rows


def pareto_front(rows: pd.DataFrame) -> pd.DataFrame:
    """Return the rows than which no cheaper row is as accurate, the cheapest first."""
    best = float("inf")
    kept = []
    for at, row in rows.sort_values(["cpu", "error"]).iterrows():
        if row["error"] < best:
            best = row["error"]
            kept.append(at)
    return rows.loc[kept]


def cheapest(rows: pd.DataFrame, accuracy: float) -> Mapping[str, Any] | None:
    """Return the cheapest row within ``accuracy``, or None."""
    within = rows[rows["error"] <= accuracy]
    return None if within.empty else within.loc[within["cpu"].idxmin()].to_dict()


def advice(table: pd.DataFrame) -> pd.DataFrame:
    """Return advice.csv: the Pareto fronts of every nu, with the columns COLUMNS."""
    rows = rows_with_error(table)
    fronts = [pareto_front(mine) for _, mine in rows.groupby("nu")]
    if not fronts:
        return pd.DataFrame(columns=list(COLUMNS))
    return pd.concat(fronts)[list(COLUMNS)]


def sentences(table: pd.DataFrame, accuracies: Sequence[float] = ACCURACIES) -> Iterator[str]:
    """Yield a sentence for each nu and accuracy, with a comparison to elements that lock."""
    rows = rows_with_error(table)
    for nu in sorted(table["nu"].unique()):
        mine = rows[rows["nu"] == nu]
        head = f"{table['scene'].iloc[0]}, nu = {nu:g}"
        if mine.empty:
            yield f"{head}: no reference that is accurate enough, no recommendation"
            continue
        fastest = mine.loc[mine["cpu"].idxmin()].to_dict()
        for accuracy in accuracies:
            answer = _recommendation(mine, fastest, accuracy)
            yield f"{head}, {percent(accuracy)} of displacement: {answer}"


def _recommendation(rows: pd.DataFrame, fastest: Mapping[str, Any], accuracy: float) -> str:
    """Return the cheapest settings within ``accuracy``, with their cost over the fastest row's."""
    found = cheapest(rows, accuracy)
    if found is None:
        floor = rows["floor"].min()
        best = rows.loc[rows["error"].idxmin()].to_dict()
        if floor > accuracy:
            return f"unknown, the reference resolves errors above {percent(floor)} only"
        return f"no setting that was run; best: {describe(best)}, {error(best)}"
    times = found["cpu"] / fastest["cpu"]
    answer = f"use {describe(found)}: {error(found)}, {found['cpu']:.2g} s"
    answer += f", {_round(times)} times the cheapest" if times > 1.05 else ", the cheapest"
    locks = [e for e in rows["element"].unique() if _locks(e)]
    return answer + "".join(f"; {_comparison(rows, e, found, accuracy)}" for e in locks)


def _locks(element: str) -> bool:
    """Return whether an element locks for nu -> 1/2: of degree 1, with a pointwise volume term."""
    return ELEMENTS[element].volume == "pointwise" and ELEMENTS[element].degree == 1


def _comparison(rows: pd.DataFrame, element: str, found: Mapping[str, Any], accuracy: float) -> str:
    """Return a comparison of an element that locks with the recommended row."""
    if element == found["element"]:
        return f"{element} does not lock here"
    mine = rows[rows["element"] == element]
    other = cheapest(mine, accuracy)
    if other is not None:
        return f"{element} takes {_round(other['cpu'] / found['cpu'])} times that"
    finest = mine.loc[mine["dofs"].idxmax()].to_dict()
    dearer = _round(finest["cpu"] / found["cpu"])
    return f"{element} does not reach it: {_where(finest)}, {dearer} times that, {error(finest)}"


def by_element(table: pd.DataFrame, accuracies: Sequence[float] = ACCURACIES) -> list[list[str]]:
    """Return rows (nu, element, processor seconds to each accuracy, smallest error)."""
    rows = rows_with_error(table)
    lines = []
    for (nu, element), mine in rows.groupby(["nu", "element"], sort=True):
        found = [cheapest(mine, accuracy) for accuracy in accuracies]
        finest = mine.loc[mine["error"].idxmin()].to_dict()
        cells = [f"{f['cpu']:.2g} s ({_where(f)})" if f else "-" for f in found]
        lines.append([f"{nu:g}", str(element), *cells, f"{error(finest)} ({_where(finest)})"])
    return lines


def page(table: pd.DataFrame) -> str:
    """Return advice.md: the sentences and the table by element."""
    asked = [percent(a) for a in ACCURACIES]
    head = ["nu", "element", *asked, "best"]
    listed = "\n".join(f"- {sentence}" for sentence in sentences(table))
    return f"{listed}\n\n{markdown_table(head, by_element(table))}\n"


def describe(row: Mapping[str, Any]) -> str:
    """Return the settings of a row as text."""
    named = [str(row[knob]) for knob in ("hessian", "solver") if row[knob] != AUTOMATIC]
    return ", ".join([str(row["element"]), _where(row), *named]) + "".join(
        f", {knob} {row[knob]:g}"
        for knob, default in (("forcing", 0.1), ("tolerance", 1e-7))
        if row[knob] != default
        and not (knob == "forcing" and str(row["solver"]).endswith("direct"))
    )


def _where(row: Mapping[str, Any]) -> str:
    cells = row["cells"]
    return f"{cells:g} cells" if cells == cells and cells not in (None, "") else str(row["mesh"])


def error(row: Mapping[str, Any]) -> str:
    """Return an error as text, with "<=" if it is below the accuracy of the reference."""
    return ("<= " if row["error"] <= row["floor"] else "") + percent(row["error"])


def _round(times: float) -> str:
    """Return a factor with two digits, without an exponent."""
    return f"{float(f'{times:.2g}'):g}"


def percent(part: float) -> str:
    """Return a fraction in per cent: 0.012 as "1.2 %"."""
    return f"{100 * part:.2g} %"
