"""Run the extremes: every case in a process of its own, one row each, and a page.

The folder holds extremes.json (the definition), extremes.csv (a row is appended when a case ends),
extremes.md with its pictures, and one folder per case with its log and record. An interrupted study
continues when it is called again, also with more families or seeds.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module, resources
from pathlib import Path
from typing import Any

import pandas as pd

from fem_snh.atomic_files import replace_file
from fem_snh.errors import BadInput, check_whole, choose
from fem_snh.studies.batch import Batch
from fem_snh.studies.extremes import FAMILIES
from fem_snh.studies.extremes.cases import COLUMNS, MAY_FAIL, PASS, Case
from fem_snh.studies.markdown import markdown_table
from fem_snh.studies.point import Limits

#: Largest number of scrambled cubes: at seconds for each, such a study takes about a day.
MAX_SEEDS = 10_000
#: The columns of results of a table on the page: of the cases that share a row.
_RESULTS = {
    "Newton": ("newton", "median"),
    "at most": ("newton", "max"),
    "filtered": ("clamped", "median"),
    "linear": ("linear", "median"),
    "NaN seen": ("nonfinite", "median"),
    "load": ("load", "median"),
    "min J": ("min_J", "median"),
    "energy": ("energy", "median"),
    "volume": ("volume_ratio", "median"),
    "difference": ("difference", "max"),
    "seconds": ("seconds", "median"),
}
_OTHER = "The runs use `{}`; the theory below is for Stable Neo-Hookean."
#: Failed cases that are listed for each family; more are counted.
_LISTED = 30


@dataclass(frozen=True)
class Robustness:
    """The results of the requested cases.

    Attributes
    ----------
    table : pandas.DataFrame
        One row per case.
    aggregate : dict
        Criteria of several cases together: {criterion: the reason of a failure, or ""}.
    """

    table: pd.DataFrame
    aggregate: dict[str, str]

    @property
    def failures(self) -> dict[str, str]:
        """Return the cases and criteria that are expected to pass and fail, with the reasons."""
        failed = self.table[(self.table["expected"] == PASS) & ~self.table["passed"]]
        return dict(zip(failed["point"], failed["reason"], strict=True)) | {
            criterion: reason for criterion, reason in self.aggregate.items() if reason
        }

    @property
    def required(self) -> int:
        """Return the number of criteria that are expected to pass."""
        return int((self.table["expected"] == PASS).sum()) + len(self.aggregate)


def extremes(
    out: str | Path,
    *,
    only: Sequence[str] = (),
    quick: bool = False,
    seeds: int = 100,
    material: str = "",
    report: Callable[[str], None] = print,
    **limits: Any,
) -> Robustness:
    """Run the requested cases that have no row yet and return the results of all.

    Parameters
    ----------
    out : str | Path
        The folder; a study that it holds is continued.
    only : sequence of str
        Families; default: all.
    quick : bool
        A few small cases of each family, in minutes.
    seeds : int
        Scrambles of each small cube.
    material : str
        Name of a material, or ``FILE.py:NAME`` for one of your own. Its pointwise errors must be
        within their bounds; its runs may fail, as the theory of the page is that of Stable
        Neo-Hookean. Default: every built-in material pointwise, Stable Neo-Hookean in the runs.
    report : callable
        Called with one line per case, and with the path of the page.
    limits : Any
        Jobs, timeout, memory, retry, overwrite, as for `fem_snh.studies.sweep.sweep`.

    Raises
    ------
    BadInput
        Before anything runs: for a bad value, or if ``out`` holds another study.
    """
    for family in only:
        choose("family", family, FAMILIES)
    check_whole("seeds", seeds, 1, MAX_SEEDS)
    flags = {key: limits.pop(key, False) for key in ("retry", "overwrite")}
    cases: dict[str, Case] = {}
    for name in only or FAMILIES:
        cases |= {case.name: case for case in _family(name).cases(quick, seeds, material)}
    definition = {"quick": quick, "material": material}
    batch = Batch(
        out, "extremes", definition, COLUMNS, Limits(**limits),
        inputs=[file for case in cases.values() for file in case.point.files()],
        success="passed", results=False, report=report, **flags,
    )  # fmt: skip

    def evaluate(record: Mapping[str, Any], row: Mapping[str, Any]) -> Mapping[str, Any]:
        return cases[row["point"]].evaluate(record, row)

    with batch:
        complete = batch.run({name: case.point for name, case in cases.items()}, evaluate)
        table = pd.read_csv(batch.table.path)
        if complete:
            batch.draw()
            path = batch.out / "extremes.md"
            replace_file(path, f"# Extremes\n\n{page(table, batch.out)}")
            report(f"page: {path}")
    requested = table[table["point"].isin(list(cases))]
    return Robustness(requested, aggregate_criteria(requested) if complete else {})


def _family(name: str) -> Any:
    """Return the module of a family."""
    return import_module(f"{__package__}.{name}")


def aggregate_criteria(table: pd.DataFrame) -> dict[str, str]:
    """Return the criteria of several cases together: {criterion: why it fails, or ""}."""
    found: dict[str, str] = {}
    for name, rows in table.groupby("family", sort=False):
        criteria = getattr(_family(str(name)), "aggregate_criteria", None)
        found |= criteria(rows) if criteria else {}
    return found


def page(table: pd.DataFrame, out: Path, links: str = "") -> str:
    """Return the page of a table, without its title; draw its pictures.

    Parameters
    ----------
    table : pandas.DataFrame
        The rows of extremes.csv.
    out : Path
        The study's folder, for the pictures.
    links : str
        Prefix of the links to the files of that folder.
    """
    required = table[table["expected"] == PASS]
    materials = table.loc[table["family"] != "pointwise", "material"].dropna().unique()
    parts = [
        f"{int(required['passed'].sum())} of the {len(required)} cases that are expected to pass "
        f"do. {len(table) - len(required)} more may fail;\nthey are run for comparison. Written by "
        "`fem-snh extremes`; extremes.csv has one row per case.",
        *(_OTHER.format(name) for name in materials if name != "stable_neo_hookean"),
        "\n".join(
            f"- {what}: {why or 'passed'}" for what, why in aggregate_criteria(table).items()
        ),
    ]
    if (out / "extremes.png").exists():
        parts.append(f"![Newton iterations of every case, by family]({links}extremes.png)")
    for name in FAMILIES:
        rows = table[table["family"] == name]
        parts += _section(name, rows, out, links) if len(rows) else []
    return "\n\n".join(filter(None, parts)) + "\n"


def _section(name: str, table: pd.DataFrame, out: Path, links: str) -> Iterator[str]:
    """Yield the paragraphs of a family: what is tested, results, failures and pictures."""
    family = _family(name)
    yield (resources.files(__package__) / "about" / f"{name}.md").read_text("utf-8").strip()
    for expected, heading, failures in (
        (PASS, "Expected to pass", "Failed:"),
        (MAY_FAIL, "For comparison; these may fail", "Failed, as they may:"),
    ):
        rows = table[table["expected"] == expected]
        if len(rows):
            yield f"### {heading}: {int(rows['passed'].sum())} of {len(rows)} pass"
            yield results(rows, family.LABEL, list(family.BY))
            failed = rows[~rows["passed"]]
            lines = [f"- `{p}`: {why}" for p, why in zip(failed["point"], failed["reason"])]
            more = [f"- and {len(lines) - _LISTED} more"] if len(lines) > _LISTED else []
            yield "\n".join([failures, "", *lines[:_LISTED], *more]) if lines else ""
    for file, (caption, bodies) in getattr(family, "PICTURES", {}).items():
        if reason := _draw(out / file, bodies):
            yield f"(no picture {file}: {reason})"
        else:
            yield f"![{caption}]({links}{file})\n\n*{caption}*"


def results(rows: pd.DataFrame, label: str, by: list[str]) -> str:
    """Return a table with a line for the cases that share a label and the columns ``by``."""
    case = rows["point"].str.extract(label)[0].rename("case")
    groups = rows.assign(case=case).groupby(["case", *by], sort=False)
    reasons = groups["reason"].first().fillna(groups["status"].first())
    passed = [f"{ok} of {n} pass" for ok, n in zip(groups["passed"].sum(), groups.size())]
    numbers = groups.agg(**_RESULTS).dropna(axis="columns", how="all")
    if (groups.size() == 1).all():
        numbers = numbers.drop(columns="at most", errors="ignore")
    lines = [
        [*map(_text, key if isinstance(key, tuple) else (key,)), result, *map(_text, line)]
        for key, result, line in zip(
            numbers.index, reasons.where(groups.size() == 1, passed), numbers.to_numpy()
        )
    ]
    return markdown_table(["case", *by, "result", *numbers.columns], lines)


def _text(value: Any) -> str:
    """Return the text of a cell."""
    if isinstance(value, str):
        return value
    return "-" if value != value else f"{value:,.4g}" if abs(value) < 1e4 else f"{value:,.0f}"


def _draw(path: Path, bodies: Sequence[tuple[str, float, str]]) -> str:
    """Draw bodies side by side; return why there is no picture, or ""."""
    from fem_snh.viewing.render import compare

    folders = [found for pattern, _, _ in bodies for found in sorted(path.parent.glob(pattern))[:1]]
    try:
        if len(folders) < len(bodies):
            raise BadInput("its runs are not in this study")
        compare(folders, path, [load for _, load, _ in bodies], [label for *_, label in bodies])
    except BadInput as error:
        return "" if path.exists() else str(error)
    return ""
