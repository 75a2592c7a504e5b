"""A small table of a study with known errors, for the tests of references, errors and advice."""

from __future__ import annotations

from typing import Any

import pandas as pd

from fem_snh.studies.tradeoff import errors
from fem_snh.studies.tradeoff.knobs import KNOBS, Choice

OF = errors.quantities([], ["p"])


def row(element: str, cells: int, x: float, cpu: float = 1.0, **more: Any) -> dict[str, Any]:
    choice = Choice(element, cells, **{k: v for k, v in more.items() if k in KNOBS})
    made = {
        "point": f"{element}-{cells}-{len(more)}", "scene": "hand", "nu": 0.3, "converged": True,
        "default": not more, "h": 1 / cells, "energy": 2 * x, "volume_ratio": 1.0, "cpu": cpu,
        "p.x": x, "p.y": 0.0, "p.z": 0.0, "dofs": cells**3, "seconds": cpu,
        "newton": 1, "linear": 1, "peak_memory_mb": 1.0, "status": "as it is",
        "steps": 2,
    }  # fmt: skip
    return made | choice.row() | {k: v for k, v in more.items() if k not in KNOBS}


def by_hand() -> pd.DataFrame:
    """Q1 converges to 1 from 0.5, Q2 far faster; a filter costs half more for the same."""
    rows = [row("Q1", n, 1 - 2 / n, n**3 / 1e3) for n in (4, 8, 16)]
    rows += [row("Q2Q1", n, 1 - 0.02 / n**3, n**3 / 100) for n in (2, 4, 8, 16)]
    rows.append(row("Q2Q1", 4, 1 - 0.02 / 4**3 + 1e-5, 1.0, hessian="clamp"))
    rows.append(row("Q2Q1", 8, 0.1, 0.5, converged=False, hessian="exact"))
    return pd.DataFrame(rows)


def assessed() -> pd.DataFrame:
    return errors.assess(by_hand(), OF, lambda line: None)
