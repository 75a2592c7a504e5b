"""Faults injected into real runs: a run fails cleanly, keeps its results and can be resumed.

Each function of `FAULTS` takes an empty folder, starts runs in processes of their own, injects one
fault, resumes the run and compares its final displacement with that of an undisturbed run. The
faults are injected here, from outside: the package itself has no code for them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd

from benchmarks import Row, split_list
from benchmarks.faults.solver_faults import (
    diverging_solve,
    factors_out_of_memory,
    indefinite_preconditioner,
    nan_in_u,
    stagnating_solve,
)
from benchmarks.faults.system_faults import file_size_limit, full_disk, killed_rank, terminated
from fem_snh.errors import choose

FAULTS: dict[str, Callable[[Path], Row]] = {
    fault.__name__: fault
    for fault in (
        indefinite_preconditioner,
        stagnating_solve,
        diverging_solve,
        nan_in_u,
        factors_out_of_memory,
        killed_rank,
        full_disk,
        file_size_limit,
        terminated,
    )
}


def rows(only: str = "", write: str = "") -> Iterator[Row]:
    """Inject each fault into a run and yield one row per fault.

    Parameters
    ----------
    only : str
        Comma list of names of `FAULTS`; default: all.
    write : str
        CSV file for the rows: docs/results/extremes/faults.csv.

    Yields
    ------
    dict
        ``fault``, ``description``; ``ok`` if the run failed with the expected message, kept its
        finished steps and reached the undisturbed result after ``--resume``; ``status``, the
        message the user saw; ``newton``, ``linear``, ``seconds`` of all its runs; ``difference``,
        max ``|u - u'|`` over the extent of the body.
    """
    names = [choose("fault", name, FAULTS) for name in split_list(only)] or FAULTS
    done: list[Row] = []
    for name in names:
        fault = FAULTS[name]
        description = (fault.__doc__ or "").strip().partition("\n")[0]
        with tempfile.TemporaryDirectory(prefix="fem-snh-fault-") as folder:
            done.append({"fault": name, "description": description} | fault(Path(folder)))
        yield done[-1]
    if write:
        columns = {
            "fault": "fault", "description": "what is done", "status": "message",
            "ok": "passed", "seconds": "seconds",
        }  # fmt: skip
        pd.DataFrame(done)[list(columns)].rename(columns=columns).round(1).to_csv(
            write, index=False
        )
