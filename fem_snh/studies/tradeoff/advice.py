"""From rows with errors to advice: the Pareto front, and what to use for which accuracy."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import pandas as pd

from fem_snh.fem.elements import ELEMENTS
from fem_snh.studies.markdown import markdown_table
from fem_snh.studies.tradeoff.errors import told

#: Of the displacement, relative: what advice is given for.
ACCURACIES = (0.05, 0.01, 0.001)
#: The columns of advice: what a choice is, what it gives, what it takes.
CHOICE = (
    "element",
    "cells",
    "mesh",
    "hessian",
    "solver",
    "forcing",
    "tolerance",
    "eigensolver",
    "steps",
)
COST = ("cpu", "seconds", "dofs", "newton", "linear", "peak_memory_mb")
COLUMNS = ("scene", "nu", *CHOICE, "error", "floor", *COST)


def usable(table: pd.DataFrame) -> pd.DataFrame:
    """The rows that converged and whose error is told, with it in ``error``: at most this."""
    if "error_displacement" not in table:
        return table.iloc[:0].assign(error=[], floor=[])
    good = table["converged"].astype(str).eq("True") & table["error_displacement"].notna()
    rows = table[good].copy()
    rows["error"] = [told(row) for row in rows.to_dict("records")]
    rows["floor"] = rows["floor_displacement"]
    return rows


def front(rows: pd.DataFrame) -> pd.DataFrame:
    """The rows that nothing cheaper is as accurate as, from the cheapest on."""
    best = float("inf")
    kept = []
    for at, row in rows.sort_values(["cpu", "error"]).iterrows():
        if row["error"] < best:
            best = row["error"]
            kept.append(at)
    return rows.loc[kept]


def cheapest(rows: pd.DataFrame, accuracy: float) -> Mapping[str, Any] | None:
    """The row that costs the least of those within ``accuracy``; None without any."""
    within = rows[rows["error"] <= accuracy]
    return None if within.empty else within.loc[within["cpu"].idxmin()].to_dict()


def advice(table: pd.DataFrame) -> pd.DataFrame:
    """The fronts of every nu, as the table from which a run can be chosen: COLUMNS."""
    rows = usable(table)
    fronts = [front(mine) for _, mine in rows.groupby("nu")]
    if not fronts:
        return pd.DataFrame(columns=list(COLUMNS))
    return pd.concat(fronts)[list(COLUMNS)]


def words(table: pd.DataFrame, accuracies: Sequence[float] = ACCURACIES) -> Iterator[str]:
    """A sentence for each nu and accuracy, and what became of the elements that lock."""
    rows = usable(table)
    for nu in sorted(table["nu"].unique()):
        mine = rows[rows["nu"] == nu]
        head = f"{table['scene'].iloc[0]}, nu = {nu:g}"
        if mine.empty:
            yield f"{head}: no reference is good enough, so no advice"
            continue
        least = mine.loc[mine["cpu"].idxmin()].to_dict()
        for accuracy in accuracies:
            yield f"{head}, {percent(accuracy)} of displacement: {_answer(mine, least, accuracy)}"


def _answer(rows: pd.DataFrame, least: Mapping[str, Any], accuracy: float) -> str:
    found = cheapest(rows, accuracy)
    if found is None:
        floor = rows["floor"].min()
        best = rows.loc[rows["error"].idxmin()].to_dict()
        if floor > accuracy:
            return f"refused, the reference tells errors above {percent(floor)} only"
        return f"nothing that was tried; best: {describe(best)}, {error(best)}"
    times = found["cpu"] / least["cpu"]
    answer = f"use {describe(found)}: {error(found)}, {found['cpu']:.2g} s"
    answer += f", {_round(times)} times the cheapest" if times > 1.05 else ", the cheapest"
    locks = [e for e in rows["element"].unique() if _locks(e)]
    return answer + "".join(f"; {_against(rows, e, found, accuracy)}" for e in locks)


def _locks(element: str) -> bool:
    return ELEMENTS[element].volume == "pointwise" and ELEMENTS[element].degree == 1


def _against(rows: pd.DataFrame, element: str, found: Mapping[str, Any], accuracy: float) -> str:
    """How an element that locks compares with what was found."""
    if element == found["element"]:
        return f"{element} does not lock here"
    mine = rows[rows["element"] == element]
    other = cheapest(mine, accuracy)
    if other is not None:
        return f"{element} takes {_round(other['cpu'] / found['cpu'])} times that"
    finest = mine.loc[mine["dofs"].idxmax()].to_dict()
    dearer = _round(finest["cpu"] / found["cpu"])
    return f"{element} never does: {_where(finest)}, {dearer} times that, {error(finest)}"


def by_element(table: pd.DataFrame, accuracies: Sequence[float] = ACCURACIES) -> list[list[str]]:
    """Processor seconds of each element's cheapest row within each accuracy: nu, element, ..."""
    rows = usable(table)
    lines = []
    for (nu, element), mine in rows.groupby(["nu", "element"], sort=True):
        found = [cheapest(mine, accuracy) for accuracy in accuracies]
        finest = mine.loc[mine["error"].idxmin()].to_dict()
        cells = [f"{f['cpu']:.2g} s ({_where(f)})" if f else "-" for f in found]
        lines.append([f"{nu:g}", str(element), *cells, f"{error(finest)} ({_where(finest)})"])
    return lines


def page(table: pd.DataFrame) -> str:
    """advice.md: the sentences, and the table by element."""
    asked = [percent(a) for a in ACCURACIES]
    head = ["nu", "element", *asked, "best"]
    sentences = "\n".join(f"- {sentence}" for sentence in words(table))
    return f"{sentences}\n\n{markdown_table(head, by_element(table))}\n"


def describe(row: Mapping[str, Any]) -> str:
    """A choice in words."""
    return (
        f"{row['element']}, {_where(row)}, {row['hessian']}, {row['solver']}"
        + "".join(
            f", {knob} {row[knob]:g}"
            for knob, usual in (("forcing", 0.1), ("tolerance", 1e-7))
            if row[knob] != usual and not (knob == "forcing" and row["solver"] == "direct")
        )
        + (f", {row['eigensolver']}" if row["eigensolver"] != "cubic" else "")
    )


def _where(row: Mapping[str, Any]) -> str:
    cells = row["cells"]
    return f"{cells:g} cells" if cells == cells and cells not in (None, "") else str(row["mesh"])


def error(row: Mapping[str, Any]) -> str:
    """An error in words; "<=" where the reference cannot tell it."""
    return ("<= " if row["error"] <= row["floor"] else "") + percent(row["error"])


def _round(times: float) -> str:
    """To two digits, without an exponent."""
    return f"{float(f'{times:.2g}'):g}"


def percent(part: float) -> str:
    """0.012 as "1.2 %"."""
    return f"{100 * part:.2g} %"
