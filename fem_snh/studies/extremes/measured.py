"""The families whose cases measure by themselves: pointwise, one material a case, and faults."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fem_snh import materials
from fem_snh.studies.extremes.cases import Case, own
from fem_snh.studies.markdown import markdown


def rows(family: str, case: str, folder: Path, quick: bool) -> list[dict[str, Any]]:
    """Measure a case; ``folder`` is made, and is empty, for one that needs it."""
    module = import_module(f"{__package__}.{family}")
    if family == "pointwise":
        return list(module.measure(case, quick))
    folder.mkdir()
    return [module.FAULTS[case](folder)]


def plain(value: Any) -> Any:
    """What JSON does not know of numpy."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"{type(value).__name__} is no number or text")


def cases(family: str, quick: bool) -> list[Case]:
    """A case for every material, or for every fault."""
    if family == "pointwise":
        names = ["stable_neo_hookean", "stvk"] if quick else materials.names()
        return [own(family, name, "every error within its bound", quick) for name in names]
    faults = import_module(f"{__package__}.{family}").FAULTS
    return [
        own(family, name, (fault.__doc__ or name).strip().partition("\n")[0], quick)
        for name, fault in faults.items()
    ]


def tables(rows: pd.DataFrame) -> str:
    """A line for each case."""
    lines = [
        [row["point"].partition("-")[2], row["asked"], row["status"], f"{row['seconds']:.1f}"]
        for row in rows.fillna({"seconds": 0}).to_dict("records")
    ]
    return markdown(["case", "asked", "what came out", "seconds"], lines)
