"""The table of the solver's PETSc options."""

from __future__ import annotations

from fem_snh.solver import PREFIX
from fem_snh.solver.options import OPTIONS
from generated.table import table


def markdown() -> str:
    """Return the table of the options that this solver adds to PETSc's."""
    rows = [
        (f"`-{PREFIX}{name}`", f"`{option.default}`", f"{option.meaning} ({option.origin})")
        for name, option in OPTIONS.items()
    ]
    return table(("option", "default", "meaning, and the source of name and default"), rows)
