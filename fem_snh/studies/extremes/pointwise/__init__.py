"""Pointwise errors at the extremes: every material and filter against as many digits as it takes.

``points`` says at which F, ``oracle`` what is right there, ``bounds`` what may be lost.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np

from fem_snh.kernels.pointwise import material as make_material
from fem_snh.materials import names
from fem_snh.studies.extremes.pointwise.bounds import compare
from fem_snh.studies.extremes.pointwise.points import MODULI, QUICK, groups

Row = dict[str, Any]


def measure(material: str, quick: bool = False) -> list[Row]:
    """One row per (nu, E), group of points and quantity: its worst error beside its bound.

    ``ratio`` is the worst error over its bound (`bounds`); ``holds`` if it is at most 1; ``digits``
    counts the points at which F, known to a few roundings, decides a digit of the answer at all.
    """
    rows: list[Row] = []
    for number, (nu, E) in enumerate(QUICK if quick else MODULI):
        m = make_material(material, E=E, nu=nu)
        for group in groups(1, seed=number):
            rows += [
                {"material": material, "nu": nu, "E": E, "group": group.name, **row}
                for row in _of_group(m, group.F, number)
            ]
    return rows


def _of_group(m: Any, points: Any, seed: int) -> Iterator[Row]:
    rng = np.random.default_rng(seed)
    found: dict[str, list[tuple[Any, Any]]] = {}
    for F in points:
        for c in compare(m, F, rng):
            found.setdefault(c.quantity, []).append((c, F))
    for quantity, pairs in found.items():
        worst, F = max(pairs, key=lambda pair: pair[0].ratio)
        yield {
            "quantity": quantity,
            "points": len(pairs),
            "digits": sum(c.has_digits for c, _ in pairs),
            "error": float(worst.error),
            "bound": float(worst.bound),
            "ratio": worst.ratio,
            "holds": worst.ratio <= 1,
            "F": " ".join(x.hex() for x in F.ravel()),
        }


def summary(rows: Iterable[Row]) -> list[Row]:
    """One row per quantity: its values, how many of them F decides, the worst ratio and where."""
    found: dict[str, list[Row]] = {}
    for row in rows:
        found.setdefault(row["quantity"], []).append(row)
    table = []
    for quantity, of in found.items():
        worst = max(of, key=lambda row: row["ratio"])
        table.append(
            {
                "quantity": quantity,
                "points": sum(row["points"] for row in of),
                "decided": sum(row["digits"] for row in of),
                "worst error / bound": round(worst["ratio"], 3),
                "where": f"{worst['material']}, nu = {worst['nu']:g}, {worst['group']}",
                "holds": all(row["holds"] for row in of),
            }
        )
    return table


def main(quick: bool = False) -> int:
    """Print the summary over every material as a table; 0 if every bound holds."""
    table = summary(row for name in names() for row in measure(name, quick))
    print("| " + " | ".join(table[0]) + " |\n" + "|---" * len(table[0]) + "|")
    for row in table:
        print("| " + " | ".join(map(str, row.values())) + " |", flush=True)
    return 0 if all(row["holds"] for row in table) else 1
