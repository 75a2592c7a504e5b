"""What goes wrong in a run, made to happen to real ones: it ends well, and can be resumed.

Each of `FAULTS` takes an empty folder, starts runs in processes of their own, sees the fault
happen, has the run resumed, compares its end with that of a run to which nothing happened, and
returns a row: ``holds``, ``status`` (what the user saw), ``newton``, ``linear``, ``seconds``,
``difference`` (max |u - u'| over the body's extent).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from fem_snh.studies.extremes.faults.processes import (
    file_cut_short,
    full_disk,
    killed_rank,
    terminated,
)
from fem_snh.studies.extremes.faults.solves import (
    diverging_solve,
    factors_out_of_memory,
    indefinite_preconditioner,
    nan_in_u,
    stagnating_solve,
)

FAULTS: dict[str, Callable[[Path], dict[str, Any]]] = {
    fault.__name__: fault
    for fault in (
        indefinite_preconditioner,
        stagnating_solve,
        diverging_solve,
        nan_in_u,
        factors_out_of_memory,
        killed_rank,
        full_disk,
        file_cut_short,
        terminated,
    )
}
