"""Faults injected into real runs: a run fails cleanly, keeps its results and can be resumed.

Each function of `FAULTS` takes an empty folder, starts runs in processes of their own, injects one
fault, resumes the run and compares its final displacement with that of an undisturbed run. The
faults are injected here, from outside: the package itself has no code for them.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from benchmarks import Row, page_tables, split_list
from benchmarks.faults.solver_faults import (
    diverging_solve,
    factors_out_of_memory,
    indefinite_preconditioner,
    nan_in_u,
    stagnating_solve,
)
from benchmarks.faults.system_faults import file_size_limit, full_disk, killed_rank, terminated
from fem_snh.errors import choose
from fem_snh.studies.markdown import markdown_table

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
        A page whose table is replaced by these rows: docs/results/extremes_tables.md.

    Yields
    ------
    dict
        ``fault``, ``description``; ``ok`` if the run failed with the expected message, kept its
        finished steps and reached the undisturbed result after ``--resume``; ``status``, the
        message the user saw; ``newton``, ``linear``, ``seconds`` of all its runs; ``difference``,
        max ``|u - u'|`` over the extent of the body.
    """
    names = [choose("fault", name, FAULTS) for name in split_list(only)] or FAULTS
    parts = page_tables.split_page(Path(write), "faults") if write else ("", "")
    done = []
    for name in names:
        fault = FAULTS[name]
        description = (fault.__doc__ or "").strip().partition("\n")[0]
        with tempfile.TemporaryDirectory(prefix="fem-snh-fault-") as folder:
            done.append({"fault": name, "description": description} | fault(Path(folder)))
        yield done[-1]
    if write:
        page_tables.write_table(Path(write), "faults", parts, table(done))


def table(found: list[Row]) -> str:
    """Return the rows as a Markdown table."""
    head = ("fault", "what is done", "message", "passed", "seconds")
    lines = [
        [row["fault"], row["description"], row["status"], str(row["ok"]), f"{row['seconds']:.1f}"]
        for row in found
    ]
    return markdown_table(head, lines)
