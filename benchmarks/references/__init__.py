"""Published numbers of finite strain beside ours, one row per number.

docs/results/references.md lists the sources; ``--write`` rewrites the CSV file beside it.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterator
from pathlib import Path

from mpi4py import MPI

from benchmarks import Row, split_list
from benchmarks.references.block import block
from benchmarks.references.cook import cook, cook_large, cook_locking, cook_locking_free
from benchmarks.references.exact import plane_strain, torsion, uniaxial
from benchmarks.references.paper import paper_stretch, paper_twist
from fem_snh.errors import choose
from fem_snh.files import replace_file

GROUPS: dict[str, Callable[[], Iterator[Row]]] = {
    f.__name__: f
    for f in (
        cook, cook_large, cook_locking, cook_locking_free, block, uniaxial, plane_strain, torsion,
        paper_twist, paper_stretch,
    )
}  # fmt: skip


def rows(only: str = "", write: str = "") -> Iterator[Row]:
    """Compute every reference value. Collective.

    Parameters
    ----------
    only : str
        Comma list of names of `GROUPS`; default: all.
    write : str
        A CSV file that gets these rows.

    Raises
    ------
    BadInput
        On every rank, for an unknown group.
    """
    groups = [choose("reference", name, GROUPS) for name in split_list(only) or GROUPS]
    done: list[Row] = []
    for name in groups:
        for row in GROUPS[name]():
            done.append({"reference": name} | row)
            yield done[-1]
    if write and MPI.COMM_WORLD.rank == 0:
        replace_file(Path(write), table(done))


def table(found: list[Row]) -> str:
    """Return the rows as CSV."""
    text = io.StringIO()
    lines = csv.writer(text, lineterminator="\n")
    lines.writerow(
        ("reference", "number", "source", "published", "ours", "difference", "limit", "met")
    )
    for row in found:
        ours, difference = row["ours"], row["difference"]
        lines.writerow(
            [
                row["reference"],
                row["what"],
                row["source"],
                f"{row['published']:.6g}",
                "did not converge" if ours is None else f"{ours:.6g}",
                "" if difference is None else f"{_signed(difference)} %",
                "" if row["limit"] is None else f"{row['limit']:g} %",
                row.get("note") or ("ok" if row["ok"] else "not met"),
            ]
        )
    return text.getvalue()


def _signed(percent: float) -> str:
    """Return two digits with a sign; 0 for rounding errors."""
    return "0" if abs(percent) < 1e-9 else f"{percent:+.2g}"
