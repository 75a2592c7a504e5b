"""A table of materials: the constants at small strain and the stability of each."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from fem_snh import materials
from fem_snh.atomic_files import write_file
from fem_snh.errors import BadInput
from fem_snh.kernels.material import material
from fem_snh.kernels.reports import stability
from fem_snh.kernels.reports.minima import minima
from fem_snh.kernels.reports.report import domain

#: The columns in order; the columns ``*_reason`` give the reason of a verdict that is not "passed".
COLUMNS = (
    "name", "nu", "mu_lame", "lambda_lame",
    "inversion", "reflection", "rest", "degeneracy",
    "inversion_reason", "reflection_reason", "rest_reason", "degeneracy_reason",
    "minima", "domain", "stretches", "note",
)  # fmt: skip


def rows(
    *names: str, E: float = 1.0, nu: float = 0.49, **keywords: Any
) -> Iterator[dict[str, Any]]:
    """Yield a row (the keys are `COLUMNS`) for each material, once its kernel is compiled.

    A material that cannot have this nu has a row with the reason as ``note``.

    Parameters
    ----------
    *names : str
        The materials; all of `fem_snh.materials()` by default.
    E, nu : float
        Young's modulus [Pa] and Poisson's ratio.
    **keywords : Any
        Shape and tuning parameters.

    Raises
    ------
    BadInput
        If no material accepts the parameters.
    """
    refused: list[BadInput] = []
    chosen = names or materials.names()
    for name in chosen:
        try:
            yield row(name, E, nu, **keywords)
        except BadInput as error:
            refused.append(error)
            if len(refused) == len(chosen):
                raise
            yield dict.fromkeys(COLUMNS, "") | {"name": name, "note": str(error)}


def row(name: str, E: float = 1.0, nu: float = 0.49, **keywords: Any) -> dict[str, Any]:
    """Return the row of one material; raise BadInput if it does not accept the parameters."""
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
        | {f"{s.name}_reason": s.reason for s in four}
        | {
            "minima": str(found),
            "domain": domain(tuple(map(str, m.expression.domain))),
            "stretches": m.expression.needs_stretches,
            "note": "" if m.expression.has_energy else "no energy",
        }
    )


def write(path: Path, table: list[dict[str, Any]]) -> None:
    """Write the rows as CSV; raise BadInput if ``path`` cannot be written."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, lineterminator="\n")
    writer.writeheader()
    writer.writerows(table)
    write_file(path, text.getvalue())
