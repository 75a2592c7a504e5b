"""Write the page of the study: criteria, results, failures and pictures, family by family."""

from __future__ import annotations

from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pandas as pd

from fem_snh.atomic_files import replace_file
from fem_snh.studies.extremes import FAMILIES
from fem_snh.studies.extremes.cases import MAY_FAIL, PASS

_OTHER = "The runs use `{}`; the theory below is for Stable Neo-Hookean."
#: Failed cases that are listed for each family; more are counted.
_LISTED = 30


def write(table: pd.DataFrame, out: Path) -> Path:
    """Draw the pictures, write extremes.md into the study's folder and return its path."""
    path = out / "extremes.md"
    replace_file(path, f"# Extremes\n\n{text(table, out)}")
    return path


def text(table: pd.DataFrame, out: Path, links: str = "") -> str:
    """Return the page of a table, without its title.

    Parameters
    ----------
    table : pandas.DataFrame
        The rows of extremes.csv.
    out : Path
        The study's folder, for the pictures.
    links : str
        Prefix of the links to the files of that folder.
    """
    parts = [_summary(table)]
    if (out / "extremes.png").exists():
        parts.append(f"![Newton iterations of every case, by family]({links}extremes.png)")
    for family in FAMILIES:
        rows = table[table["family"] == family]
        if len(rows):
            parts += _family(family, rows, out, links)
    return "\n\n".join(parts) + "\n"


def aggregate_criteria(table: pd.DataFrame) -> dict[str, str]:
    """Return the criteria of several cases together: {criterion: why it fails, or ""}."""
    found: dict[str, str] = {}
    for family, rows in table.groupby("family", sort=False):
        module = _module(str(family))
        if hasattr(module, "aggregate_criteria"):
            found |= module.aggregate_criteria(rows)
    return found


def _summary(table: pd.DataFrame) -> str:
    """Return the counts of cases that pass, and the criteria of several cases together."""
    required = table[table["expected"] == PASS]
    passed = int(required["passed"].sum())
    aggregate = aggregate_criteria(table).items()
    materials = table.loc[table["family"] != "pointwise", "material"].dropna()
    other = [name for name in materials.unique() if name != "stable_neo_hookean"]
    lines = [f"- {criterion}: {reason or 'passed'}" for criterion, reason in aggregate]
    return "\n".join(
        [
            f"{passed} of the {len(required)} cases that are expected to pass do. "
            f"{len(table) - len(required)} more may fail;",
            "they are run for comparison. Written by `fem-snh extremes`; extremes.csv has one row "
            "per case.",
            *(["", *(_OTHER.format(name) for name in other)] if other else []),
            *(["", *lines] if lines else []),
        ]
    )


def _family(family: str, rows: pd.DataFrame, out: Path, links: str) -> Iterator[str]:
    """Yield the paragraphs of a family: its description, results, failures and pictures."""
    module = _module(family)
    yield f"## {module.title}"
    yield str(module.about)
    for expected, heading, failures in (
        (PASS, "Expected to pass", "Failed:"),
        (MAY_FAIL, "For comparison; these may fail", "Failed, as they may:"),
    ):
        group = rows[rows["expected"] == expected]
        if len(group):
            yield f"### {heading}: {int(group['passed'].sum())} of {len(group)} pass"
            yield module.tables(group)
            if failed := list(_failed(group[~group["passed"]])):
                yield "\n".join([failures, "", *failed])
    if hasattr(module, "pictures"):
        for picture in module.pictures(out):
            yield picture.markdown(links)


def _module(family: str) -> ModuleType:
    return import_module(f"{__package__}.{family}")


def _failed(rows: pd.DataFrame) -> Iterator[str]:
    """Yield a line for each failed case, up to `_LISTED`."""
    for row in rows.head(_LISTED).to_dict("records"):
        yield f"- `{row['point']}`: {row['reason']}"
    if len(rows) > _LISTED:
        yield f"- and {len(rows) - _LISTED} more"
