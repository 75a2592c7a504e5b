"""The page of the study: what is asked, what came out, what did not hold, pictures."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pandas as pd

from fem_snh.atomic_files import put
from fem_snh.studies.extremes import FAMILIES, measured

#: So many cases that do not hold are named, of each family.
_NAMED = 30


def write(table: pd.DataFrame, out: Path) -> Path:
    """Draw what is to be drawn, and write extremes.md into the study's folder."""
    parts = [_head(table)]
    if (out / "extremes.png").exists():
        parts.append("![Newton iterations of every case, by family](extremes.png)")
    for family in FAMILIES:
        rows = table[table["family"] == family]
        if len(rows):
            parts += _family(family, rows, out)
    path = out / "extremes.md"
    put(path, "\n\n".join(parts) + "\n")
    return path


def demands(table: pd.DataFrame) -> dict[str, str]:
    """What is asked of several cases together, in words: why it does not hold, or ""."""
    found: dict[str, str] = {}
    for family, rows in table.groupby("family", sort=False):
        found |= getattr(_module(str(family)), "demands", lambda rows: {})(rows)
    return found


def _head(table: pd.DataFrame) -> str:
    must = table[table["must"]]
    held = int(must["holds"].sum())
    lines = [f"- {asked}: {why or 'holds'}" for asked, why in demands(table).items()]
    return "\n".join(
        [
            "# Extremes",
            "",
            f"{held} of the {len(must)} cases that must hold do; {len(table) - len(must)} more are",
            "there to be compared. Written by `fem-snh extremes`; extremes.csv has a row for each.",
            *(["", *lines] if lines else []),
        ]
    )


def _family(family: str, rows: pd.DataFrame, out: Path) -> Iterator[str]:
    module = _module(family)
    yield f"## {getattr(module, 'title', family.capitalize())}"
    yield str(getattr(module, "about", (module.__doc__ or "").strip()))
    tables = getattr(module, "tables", measured.tables)
    for must, head in ((True, "Must hold"), (False, "To be compared")):
        mine = rows[rows["must"] == must]
        if len(mine):
            yield f"### {head}: {int(mine['holds'].sum())} of {len(mine)}"
            yield tables(mine)
            if bad := list(_bad(mine[~mine["holds"]])):
                yield "\n".join(["These do not:", "", *bad])
    if hasattr(module, "pictures"):
        for picture in module.pictures(out):
            yield picture.markdown()


def _module(family: str) -> ModuleType:
    return import_module(f"{__package__}.{family}")


def _bad(rows: pd.DataFrame) -> Iterator[str]:
    for row in rows.head(_NAMED).to_dict("records"):
        yield f"- `{row['point']}`: {row['why']}"
    if len(rows) > _NAMED:
        yield f"- and {len(rows) - _NAMED} more"
