"""Error estimates, contact and runs to an accuracy on more ranks: messages, and what is gathered.

Counts do not depend on the machine, and there may be more ranks than cores. They are of a whole
run, divided by its steps, and include the making of the mesh and the estimates. It needs Open MPI's
mpicc.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from math import log
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from benchmarks import Row, split_list
from benchmarks.scaling import counted, counting_library
from fem_snh.errors import choose

#: Scenes with the settings of a run, and cells along an edge: few, and about twice as many in all.
CASES: dict[str, tuple[str, dict[str, Any], tuple[int, int]]] = {
    "error": ("stretch", {"steps": 1, "stretch": 1.4, "error": True}, (8, 10)),
    "obstacle": ("press", {"steps": 2}, (10, 13)),
    "self_contact": ("hand", {"steps": 2}, (30, 38)),
    "accuracy": (
        "stretch",
        {"steps": 1, "accuracy": {"goals": ["energy"], "within": 0.03}},
        (6, 8),
    ),
}
#: A line gathers the body if its bytes grow with the cells by more than this exponent: surfaces and
#: the boundaries between ranks have 2/3.
BODY_EXPONENT = 0.85
#: Smaller calls are not reported [bytes].
_SMALL = 1000


def rows(
    cases: str = "error,obstacle,self_contact,accuracy",
    ranks: str = "1,2,4,8,16,32",
    growth_ranks: int = 4,
    size: float = 1.0,
    timeout: float = 600.0,
    memory: float = 16.0,
) -> Iterator[Row]:
    """Yield a row for each case and number of ranks, then one for each line that gathers.

    Parameters
    ----------
    cases : comma list
        Names of CASES.
    ranks : comma list
        Numbers of ranks.
    growth_ranks : int
        Ranks of the runs with fewer and with more cells, whose gathered bytes are compared.
    size : float
        Cells along an edge over those of CASES.
    timeout, memory : float
        Limits of a run [s], [GiB].

    Yields
    ------
    dict
        Per step, the largest of all ranks: ``messages``, ``message_kB``, ``collectives``,
        ``collective_kB`` and ``gathered_kB``. For a ``line`` of the package: the ``bytes`` that its
        largest call left ``on`` every rank or some ranks, with ``more_bytes`` for ``more_cells``,
        the ``exponent`` of their growth, and whether that is the ``body``.
    """
    with TemporaryDirectory() as name:
        folder = Path(name)
        library = counting_library(folder)

        def run(case: str, number: int, cells: int) -> dict[str, Any]:
            scene, settings, _ = CASES[case]
            words = scene, json.dumps(settings | {"cells": cells})
            module = "benchmarks.counted_gathers"
            return counted(folder, library, number, module, words, (timeout, memory))

        for case in split_list(cases):
            few, many = (round(size * n) for n in CASES[choose("cases", case, CASES)][2])
            for number in map(int, split_list(str(ranks))):
                yield {"case": case, "ranks": number} | _per_step(run(case, number, few))
            smaller, larger = (run(case, growth_ranks, cells) for cells in (few, many))
            yield from ({"case": case} | row for row in _growth(smaller, larger))


def _per_step(run: dict[str, Any]) -> Row:
    """Return the counts of a run, per step."""
    names = "messages", "message_kB", "collectives", "collective_kB", "gathered_kB"
    row: Row = {key: run[key] for key in ("dofs", "cells", "steps")}
    for kind, name in enumerate(names):
        most = max(of["sent"][kind] for of in run["ranks"]) / run["steps"]
        row[name] = round(most / 1e3 if name.endswith("kB") else most)
    return row | {"ok": run["converged"]}


def _growth(smaller: dict[str, Any], larger: dict[str, Any]) -> Iterator[Row]:
    """Yield the lines whose gathered bytes grow with the cells, the largest first."""
    on_every, most = (
        {
            line: pick(of["largest"].get(line, 0) for of in larger["ranks"])
            for line in _lines(larger)
        }
        for pick in (min, max)
    )
    before = {line: max(of["largest"].get(line, 0) for of in smaller["ranks"]) for line in most}
    if larger["cells"] == smaller["cells"]:  # the last levels of two runs to an accuracy
        return
    cells = log(larger["cells"] / smaller["cells"])
    for line in sorted(most, key=lambda line: -most[line]):
        if before[line] < _SMALL:
            continue
        exponent = log(most[line] / before[line]) / cells
        on = "every rank" if on_every[line] > most[line] / 2 else "some ranks"
        row: Row = {"line": line, "on": on, "bytes": before[line], "more_bytes": most[line]}
        row |= {"cells": smaller["cells"], "more_cells": larger["cells"]}
        row["exponent"] = round(exponent, 2)
        yield row | {"body": on == "every rank" and exponent > BODY_EXPONENT}


def _lines(run: dict[str, Any]) -> set[str]:
    """Return the lines of the package that gather on any rank."""
    return set().union(*(of["largest"] for of in run["ranks"]))
