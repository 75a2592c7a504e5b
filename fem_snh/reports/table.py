"""One row per material: its constants at small strain, and which stabilities it has."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fem_snh import materials
from fem_snh.errors import BadInput
from fem_snh.reports import stability
from fem_snh.reports.minima import minima
from fem_snh.reports.report import domain

#: The columns in order; why a stability does not hold is in the column of its name with _why.
COLUMNS = (
    "name", "nu", "mu_lame", "lambda_lame",
    "inversion", "reflection", "rest", "degeneracy",
    "inversion_why", "reflection_why", "rest_why", "degeneracy_why",
    "minima", "domain", "stretches", "note",
)  # fmt: skip


def rows(E: float = 1.0, nu: float = 0.49, **keywords: Any) -> Iterator[dict[str, Any]]:
    """A row (the keys are `COLUMNS`) for every material, as each is ready: a kernel is compiled.

    A material that cannot be had with that nu has a row with its reason as ``note``. BadInput if
    none can, or E or a keyword is wrong for all.
    """
    refused: list[BadInput] = []
    for name in materials.names():
        try:
            yield row(name, E, nu, **keywords)
        except BadInput as error:
            refused.append(error)
            if len(refused) == len(materials.names()):
                raise
            yield dict.fromkeys(COLUMNS, "") | {"name": name, "note": str(error)}


def row(name: str, E: float = 1.0, nu: float = 0.49, **keywords: Any) -> dict[str, Any]:
    """One material's row. Raises BadInput if there is no such material with these numbers."""
    from fem_snh.kernels.pointwise import material

    m = material(name, E, nu, **keywords)
    found = minima(m)
    four = (
        stability.inversion(m, found),
        stability.reflection(m),
        stability.rest(m),
        stability.degeneracy(m),
    )
    mu, lam = m.lame
    return (
        {"name": name, "nu": nu, "mu_lame": mu, "lambda_lame": lam}
        | {s.name: s.verdict for s in four}
        | {f"{s.name}_why": s.why for s in four}
        | {
            "minima": str(found),
            "domain": domain(tuple(map(str, m.expression.domain))),
            "stretches": m.expression.needs_stretches,
            "note": "" if m.expression.has_energy else "no energy",
        }
    )


def write(path: Path, table: list[dict[str, Any]]) -> None:
    """The rows as CSV. Raises BadInput if ``path`` cannot be written."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with path.open("w", newline="") as file:
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(table)
    except OSError as error:
        raise BadInput(f"{path}: cannot be written: {error.strerror or error}") from None
