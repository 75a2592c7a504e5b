"""Pointwise errors of every material and filter at extreme F, against a 50-digit oracle.

Modules: ``points`` the deformation gradients, ``oracle`` the exact values, ``bounds`` the errors
that the conditioning of the problem allows.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fem_snh import materials
from fem_snh.kernels.material import material as make_material
from fem_snh.references import file_of, is_reference
from fem_snh.studies.extremes.cases import Case, Record, Row, case_columns
from fem_snh.studies.extremes.pointwise.bounds import compare
from fem_snh.studies.extremes.pointwise.points import MODULI, QUICK, groups
from fem_snh.studies.markdown import markdown_table
from fem_snh.studies.point import Point
from fem_snh.studies.sweep import folder_name
from fem_snh.studies.table import failure_message

title = "Pointwise"
about = """\
Energy, stress, Hessian, its filters and its eigenvalues at extreme deformation gradients (stretches
from 1e-12 to 1e12, equal, zero, negative; strains down to 1e-15), for nu from -0.9 to 0.4999999, in
double precision against the same in 50 digits. The criterion is that every error is within the
bound that the rounding of F implies (`fem_snh/studies/extremes/pointwise/bounds.py`)."""


def measure(material: str, quick: bool = False) -> list[dict[str, Any]]:
    """Compare a material with the oracle.

    ``quick`` takes two (nu, E), and each group of points at one of them, in turns; the parity of
    the name's length decides with which they begin, so that all materials together meet every pair.

    Returns
    -------
    list of dict
        One row per (nu, E), group of points and quantity, for its worst point: ``ratio`` of the
        error to its bound, ``passed`` if that is at most 1, ``digits``, the number of points where
        the bound is smaller than the quantity itself.
    """
    rows: list[dict[str, Any]] = []
    for number, (nu, E) in enumerate(QUICK if quick else MODULI):
        m = make_material(material, E=E, nu=nu)
        for turn, group in enumerate(groups(1, seed=number), len(material) + number):
            if quick and turn % 2:
                continue
            rows += [
                {"material": material, "nu": nu, "E": E, "group": group.name, **row}
                for row in _compare_group(m, group.F, number)
            ]
    return rows


def _compare_group(m: Any, points: Any, seed: int) -> Iterator[dict[str, Any]]:
    """Yield the row of each quantity at the points of a group."""
    rng = np.random.default_rng(seed)
    compared: dict[str, list[tuple[Any, Any]]] = {}
    for F in points:
        for c in compare(m, F, rng):
            compared.setdefault(c.quantity, []).append((c, F))
    for quantity, pairs in compared.items():
        worst, F = max(pairs, key=lambda pair: pair[0].ratio)
        yield {
            "quantity": quantity,
            "points": len(pairs),
            "digits": sum(c.has_digits for c, _ in pairs),
            "error": float(worst.error),
            "bound": float(worst.bound),
            "ratio": worst.ratio,
            "passed": worst.ratio <= 1,
            "F": " ".join(x.hex() for x in F.ravel()),
        }


def summary(rows: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return one row per quantity: its number of points, the worst ratio and where it occurs."""
    by_quantity: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        by_quantity.setdefault(row["quantity"], []).append(row)
    table = []
    for quantity, group in by_quantity.items():
        worst = max(group, key=lambda row: row["ratio"])
        table.append(
            {
                "quantity": quantity,
                "points": sum(row["points"] for row in group),
                "decided": sum(row["digits"] for row in group),
                "worst error / bound": round(worst["ratio"], 3),
                "where": f"{worst['material']}, nu = {worst['nu']:g}, {worst['group']}",
                "passed": all(row["passed"] for row in group),
            }
        )
    return table


def main(quick: bool = False) -> int:
    """Print the summary over every built-in material as a table; return 0 if all rows pass."""
    table = summary(row for name in materials.names() for row in measure(name, quick))
    print(markdown_table(list(table[0]), [[str(v) for v in row.values()] for row in table]))
    return 0 if all(row["passed"] for row in table) else 1


@dataclass(frozen=True)
class PointwisePoint(Point):
    """The measurement of one material, whose record has the rows of `measure`."""

    material: str
    quick: bool

    module = "fem_snh.studies.extremes.pointwise"
    parallel = False
    record = "record.json"

    def arguments(self, folder: Path) -> list[str]:
        """Return the arguments of ``python -m fem_snh.studies.extremes.pointwise``."""
        return [self.material, str(folder), *(["--quick"] if self.quick else [])]

    def files(self) -> list[Path]:
        """Return the file of a material of the user's own."""
        return [file_of(self.material)] if is_reference(self.material) else []

    def requested(self) -> Mapping[str, Any]:
        """Return the material."""
        return {"material": self.material}

    def measured(self, record: Record, log: Path, code: int) -> Mapping[str, Any]:
        """Return how many rows pass, and the time."""
        rows = record.get("rows", []) if code == 0 else []
        if not rows:
            return {"status": failure_message(log, code), "seconds": record.get("seconds")}
        passed = sum(bool(row["passed"]) for row in rows)
        return {"status": f"{passed} of {len(rows)} pass", "seconds": record["seconds"]}


def all_rows_pass(record: Record, row: Row) -> str:
    """Check that every row of the record passes; name the first ones that do not."""
    failed = [r for r in record["rows"] if not r["passed"]]
    names = [" ".join(str(v) for v in r.values() if isinstance(v, str)) for r in failed[:3]]
    more = f" and {len(failed) - 3} more" if len(failed) > 3 else ""
    return ("; ".join(names) or str(row["status"])) + more if failed else ""


def case(material: str, quick: bool) -> Case:
    """Return the case of one material."""
    columns = case_columns("pointwise", "every error within its bound", True)
    point = PointwisePoint(material, quick, columns=columns)
    return Case(f"pointwise-{folder_name([material])}", point, all_rows_pass)


def cases(quick: bool, seeds: int, material: str = "") -> list[Case]:
    """Return a case for the material, or for every built-in material."""
    if material:
        make_material(material)  # a mistake is reported before anything runs
        return [case(material, quick)]
    names = ["stable_neo_hookean", "stvk"] if quick else materials.names()
    return [case(name, quick) for name in names]


def tables(rows: pd.DataFrame) -> str:
    """Return a line for each material."""
    lines = [
        [row["point"].partition("-")[2], row["criterion"], row["status"], f"{row['seconds']:.1f}"]
        for row in rows.fillna({"seconds": 0}).to_dict("records")
    ]
    return markdown_table(["material", "criterion", "result", "seconds"], lines)
