"""The tables of docs/results/tradeoff_tables.md, rewritten from the CSV files beside it.

The text between ``<!-- table: SCENE KIND -->`` and ``<!-- end -->`` is replaced by a table of
docs/results/tradeoff/SCENE.csv; `TABLES` lists the kinds.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from benchmarks import Row, page_tables
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.choices import HESSIANS
from fem_snh.errors import BadInput, choose
from fem_snh.files import replace_file
from fem_snh.studies.markdown import markdown_table
from fem_snh.studies.tradeoff import advice
from fem_snh.studies.tradeoff.grid import changed_knobs
from fem_snh.studies.tradeoff.knobs import AUTOMATIC, KNOBS, Choice

#: The columns of a table of filters.
_POLICIES = (*HESSIANS, AUTOMATIC)
_TABLE = re.compile(r"(<!-- table: (\w+) (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)


def fill(text: str, tables: Mapping[str, pd.DataFrame]) -> str:
    """Return a page with new tables; BadInput for an unknown scene or kind."""

    def made(found: re.Match[str]) -> str:
        begin, scene, kind, end = found.groups()
        table = tables[choose("scene of a table", scene, tables)]
        return begin + TABLES[choose("table", kind, TABLES)](table) + "\n" + end

    return _TABLE.sub(made, text)


def locking(table: pd.DataFrame) -> str:
    """Return the error of each element by nu, on meshes with similar numbers of unknowns."""
    rows = advice.rows_with_error(_default(table))
    lines = []
    for element in _elements(table):
        cells = _alike(table, element)
        mine = rows[(rows["element"] == element) & (rows["cells"] == cells)].set_index("nu")
        dofs = f"{mine['dofs'].iloc[0]:,.0f}" if len(mine) else "-"
        cell = [advice.error(mine.loc[nu]) if nu in mine.index else "-" for nu in _nus(table)]
        lines.append([element, f"{cells:g}", dofs, *cell])
    return markdown_table(["element", "cells", "dofs", *_heads(table)], lines)


def price(table: pd.DataFrame) -> str:
    """Return the processor seconds to errors of 5 % and 1 %, by element and nu."""
    rows = advice.rows_with_error(table)
    lines = []
    for element in _elements(table):
        for accuracy in (0.05, 0.01):
            cell = []
            for nu in _nus(table):
                mine = rows[(rows["element"] == element) & (rows["nu"] == nu)]
                cell.append(_seconds(mine, accuracy))
            lines.append([element, advice.percent(accuracy), *cell])
    return markdown_table(["element", "error", *_heads(table)], lines)


def _seconds(rows: pd.DataFrame, accuracy: float) -> str:
    if rows.empty:
        return ""
    if rows["floor"].min() > accuracy:
        return "refused"
    found = advice.cheapest(rows, accuracy)
    return "never" if found is None else f"{found['cpu']:.2g} ({found['cells']:g})"


def iterations(table: pd.DataFrame) -> str:
    """Return the Newton iterations on the same meshes, by nu."""
    default = _default(table)
    lines = []
    for element in _elements(table):
        mine = default[default["element"] == element]
        cells = _alike(table, element)
        on = mine[mine["cells"] == cells].set_index("nu")
        cell = [_counted(on.loc[nu]) if nu in on.index else "-" for nu in _nus(table)]
        lines.append([element, f"{cells:g}", *cell])
    return markdown_table(["element", "cells", *_heads(table)], lines)


def _alike(table: pd.DataFrame, element: str) -> float:
    """Return the cells whose number of unknowns is nearest to the median of all default rows."""
    dofs = _default(table).dropna(subset=["dofs"])[["element", "cells", "dofs"]]
    off = np.abs(np.log(dofs["dofs"] / dofs["dofs"].median()))
    return float(dofs.loc[off[dofs["element"] == element].idxmin(), "cells"])


def _counted(row: Mapping[str, Any]) -> str:
    return f"{row['newton']:g}" if str(row["converged"]) == "True" else "fails"


def knobs(table: pd.DataFrame) -> str:
    """Return the effect of each knob: iterations, time relative to the default, and the shift."""
    lines = []
    for nu in _nus(table):
        for element in _elements(table):
            lines += list(_turned(table[(table["nu"] == nu) & (table["element"] == element)]))
    head = ["nu", "element", "cells", "knob", "Newton", "linear", "time", "shift of displacement"]
    return markdown_table(head, lines)


def _turned(rows: pd.DataFrame) -> Iterator[list[str]]:
    """Yield the default row and the rows with one knob changed, of one element and nu."""
    turned = rows[rows["default"].astype(str) != "True"]
    if turned.empty:
        return
    cells = turned["cells"].iloc[0]
    base = rows[(rows["default"].astype(str) == "True") & (rows["cells"] == cells)].iloc[0]
    yield [*_where(base), "default: " + _setting(base, KNOBS), *_cost(base, base)]
    for _, row in turned.iterrows():
        other = [knob for knob in KNOBS if knob in changed_knobs(_choice(row), _choice(base))]
        yield [*_where(row), _setting(row, other), *_cost(row, base)]


def _choice(row: Mapping[str, Any]) -> Choice:
    return Choice(row["element"], int(row["cells"]), **{knob: row[knob] for knob in KNOBS})


def _where(row: Mapping[str, Any]) -> list[str]:
    return [f"{row['nu']:g}", row["element"], f"{row['cells']:g}"]


def _setting(row: Mapping[str, Any], names: Sequence[str]) -> str:
    return ", ".join(
        f"{knob} {row[knob]:g}" if isinstance(row[knob], float) else str(row[knob])
        for knob in names
    )


def _cost(row: Mapping[str, Any], base: Mapping[str, Any]) -> list[str]:
    if str(row["converged"]) != "True":
        return ["", "", str(row["status"]), ""]
    counts = [f"{row['newton']:g}", f"{row['linear']:,.0f}"]
    if row is base:
        return [*counts, f"{row['cpu']:.2g} s", ""]
    return [*counts, f"x {row['cpu'] / base['cpu']:.2g}", f"{row['shift']:.0e}"]


def filters(table: pd.DataFrame) -> str:
    """Return Newton iterations by Hessian policy, and times relative to the default."""
    lines = []
    for key, rows in table.groupby(["nu", "element", "cells"]):
        base = _default(rows)
        if base.empty:
            continue
        default = base.iloc[0]
        only = [
            changed_knobs(_choice(row), _choice(default)) <= {"hessian"}
            for _, row in rows.iterrows()
        ]
        mine = rows[only].set_index("hessian")
        if len(mine) > 1:
            cells = [_filtered(mine, policy, default) for policy in _POLICIES]
            lines.append([f"{key[0]:g}", str(key[1]), f"{key[2]:g}", *cells])
    return markdown_table(["nu", "element", "cells", *_POLICIES], lines)


def _filtered(rows: pd.DataFrame, policy: str, default: Mapping[str, Any]) -> str:
    if policy not in rows.index:
        return ""
    row = rows.loc[policy]
    counted = _counted(row)
    return counted if counted == "fails" else f"{counted}, x {row['cpu'] / default['cpu']:.2g}"


def _default(table: pd.DataFrame) -> pd.DataFrame:
    return table[table["default"].astype(str) == "True"]


def _nus(table: pd.DataFrame) -> list[float]:
    return sorted(table["nu"].unique())


def _heads(table: pd.DataFrame) -> list[str]:
    return [f"nu = {nu:g}" for nu in _nus(table)]


def _elements(table: pd.DataFrame) -> list[str]:
    return [element for element in ELEMENTS if element in set(table["element"])]


#: The tables by the kind that a page names.
TABLES: dict[str, Callable[[pd.DataFrame], str]] = {
    "locking": locking,
    "price": price,
    "iterations": iterations,
    "knobs": knobs,
    "filters": filters,
    "advice": lambda table: "\n".join(f"- {sentence}" for sentence in advice.sentences(table)),
}


def rows(write: str = "docs/results/tradeoff_tables.md") -> Iterator[Row]:
    """Rewrite the tables of a page from the CSV files in its data folder.

    Yields
    ------
    dict
        One row per table: ``page``, ``scene``, ``table``.

    Raises
    ------
    BadInput
        If the page cannot be read.
    """
    page = Path(write)
    try:
        text = page.read_text(encoding="utf-8")
    except OSError as error:
        raise BadInput(f"write = {page}: cannot be read: {error.strerror}") from None
    folder = page_tables.data_folder(page)
    tables = {csv.stem: pd.read_csv(csv) for csv in sorted(folder.glob("*.csv"))}
    replace_file(page, fill(text, tables))
    for _, scene, kind, _ in _TABLE.findall(text):
        yield {"page": write, "scene": scene, "table": kind}
