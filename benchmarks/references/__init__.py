"""Published numbers of finite strain beside ours: `GROUPS`, one row per number.

The sources are in docs/results/references.md, whose table `rows` makes anew.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from mpi4py import MPI

from benchmarks import Row, words
from benchmarks.references.block import block
from benchmarks.references.cook import cook, cook_large, cook_locking, cook_locking_free
from benchmarks.references.exact import plane_strain, torsion, uniaxial
from benchmarks.references.paper import paper_stretch, paper_twist
from fem_snh.errors import BadInput, choose, on_root

GROUPS: dict[str, Callable[[], Iterator[Row]]] = {
    f.__name__: f
    for f in (
        cook, cook_large, cook_locking, cook_locking_free, block, uniaxial, plane_strain, torsion,
        paper_twist, paper_stretch,
    )
}  # fmt: skip
BEGIN, END = "<!-- made by python -m benchmarks references -->", "<!-- until here -->"


def rows(only: str = "", write: str = "") -> Iterator[Row]:
    """Every reference, or those of the groups in the comma list ``only``. Collective.

    write : a page, whose table between `BEGIN` and `END` becomes that of these rows.

    Raises BadInput, on every rank, for an unknown group and a page without such a table.
    """
    groups = [choose("reference", name, GROUPS) for name in words(only) or GROUPS]
    before, after = on_root(MPI.COMM_WORLD, _around, Path(write)) if write else ("", "")
    found: list[Row] = []
    for name in groups:
        for row in GROUPS[name]():
            found.append({"reference": name} | row)
            yield found[-1]
    if write and MPI.COMM_WORLD.rank == 0:
        page = f"{before}{BEGIN}\n\n{table(found)}\n\n{END}{after}"
        Path(write).write_text(page, encoding="utf-8")


def _around(page: Path) -> tuple[str, str]:
    """The text before and after a page's table."""
    before, begin, rest = page.read_text(encoding="utf-8").partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise BadInput(f"--write {page}: expected a page with the lines {BEGIN} and {END}")
    return before, after


def table(found: list[Row]) -> str:
    """Rows as a Markdown table."""
    heads = ("reference", "number", "source", "published", "ours", "difference", "limit", "")
    lines = [f"| {' | '.join(heads)} |", "|---" * len(heads) + "|"]
    for row in found:
        ours, difference = row["ours"], row["difference"]
        cells = [
            row["reference"],
            row["what"],
            row["source"],
            f"{row['published']:.6g}",
            "did not converge" if ours is None else f"{ours:.6g}",
            "" if difference is None else f"{_short(difference)} %",
            "" if row["limit"] is None else f"{row['limit']:g} %",
            row.get("note") or ("ok" if row["ok"] else "**not met**"),
        ]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def _short(percent: float) -> str:
    """Two digits and a sign; nothing of rounding."""
    return "0" if abs(percent) < 1e-9 else f"{percent:+.2g}"
