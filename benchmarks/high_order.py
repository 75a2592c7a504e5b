"""Processor time and memory of a Newton step of each element over those of Q1, and their parts."""

from __future__ import annotations

import resource
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from functools import wraps
from multiprocessing import get_context
from time import process_time
from typing import Any, cast

from benchmarks import Row, split_list
from fem_snh.errors import choose

#: Cells across the cylinder by number of unknowns: half as many with degree 2.
CELLS = {"20000": 20, "100000": 32, "300000": 48, "1000000": 72}
#: Poisson's ratio by element.
ELEMENTS = {"Q1": 0.49, "P2": 0.49, "Q2": 0.49, "P2P1": 0.4999, "Q2Q1": 0.4999}
#: Largest ratio to Q1 of the time per unknown and Newton step, by a million unknowns and a fifth.
LIMITS = {"Q1": 1.0, "P2": 1.25, "Q2": 1.6, "P2P1": 2.1, "Q2Q1": 3.0}


def rows(
    sizes: str = "100000,300000", elements: str = "P2,Q2,P2P1,Q2Q1", rounds: int = 2
) -> Iterator[Row]:
    """Yield one row per size and element, first Q1: the stretch to 1.2 in one step on one rank.

    Every run has a process of its own; the fastest of several rounds counts.

    Yields
    ------
    dict
        Processor microseconds per unknown and Newton step: ``us``, the whole step; ``assembly`` of
        the Hessian; ``setup`` and ``iterations`` of the displacement's linear solver (``inner`` of
        them); ``rest``. Bytes per unknown: ``peak``, of the process without the imports; ``aij``,
        PETSc's matrix; ``ssor``, its copy and the vectors; ``deflation``; ``positions`` of the
        cells' blocks. ``ratio``: of ``us``, to that of Q1.
    """
    for size in split_list(sizes):
        cells = CELLS[choose("size", size, CELLS)]
        chosen = ["Q1", *(choose("element", e, ELEMENTS) for e in split_list(elements))]
        runs = [[_apart(e, cells if e == "Q1" else cells // 2) for e in chosen]]
        runs += [[_apart(e, row["cells"]) for e, row in zip(chosen, runs[0], strict=True)]
                 for _ in range(rounds - 1)]  # fmt: skip
        fastest = [min(of, key=lambda row: float(row["us"])) for of in zip(*runs, strict=True)]
        for row in fastest:
            row["ratio"], limit = round(row["us"] / fastest[0]["us"], 2), LIMITS[row["element"]]
            yield row | {"limit": limit, "ok": row["ratio"] <= limit}


def _apart(element: str, cells: int) -> Row:
    """Return `_measure` in a process of its own, which shows the peak of this run."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(_measure, element, cells).result()


def _measure(element: str, cells: int) -> Row:
    """Return the measurements of one run."""
    from fem_snh.linalg.ssor_cg import EisenstatCG, SSORSystem
    from fem_snh.problem.problem import Problem
    from fem_snh.runs import run
    from fem_snh.steps.stepping import Stepper

    imports = _peak()
    clocks = {
        "us": _Clock(Stepper, "attempt"),
        "assembly": _Clock(Problem, "jacobian"),
        "setup": _Clock(EisenstatCG, "update_matrix"),
        "iterations": _Clock(EisenstatCG, "_run_cycle"),
        "directions": _Clock(SSORSystem, "update_direction"),
    }
    settings: dict[str, Any] = {"element": element, "cells": cells, "nu": ELEMENTS[element]}
    result = run("stretch", steps=1, stretch=1.2, progress=False, **settings)
    peak = _peak() - imports
    (step,), dofs = result.steps, result.record["dofs"]
    times = {name: 1e6 * clock.seconds / dofs / step["newton"] for name, clock in clocks.items()}
    del times["directions"]
    times["rest"] = times["us"] - times["assembly"] - times["setup"] - times["iterations"]
    problem, system = clocks["assembly"].owner, clocks["directions"].owner
    arrays = [*system.matrix.arrays.values(), *system._vectors.values()]
    held = {
        "peak": peak,
        "aij": 0 if problem.P.getType() == "python" else 12 * problem.P.getInfo()["nz_used"],
        "ssor": sum(array.nbytes for array in arrays),
        "deflation": sum(array.nbytes for array in system.deflation.arrays.values()),
        "positions": problem.matrix.block_positions.nbytes,
    }
    row: Row = settings | {"dofs": dofs, "newton": step["newton"], "linear": step["linear"]}
    row |= {"inner": clocks["directions"].calls}
    row |= {name: round(time, 2) for name, time in times.items()}
    return row | {name: round(size / dofs) for name, size in held.items()}


class _Clock:
    """The processor seconds in a method of a class, its calls, and the last object it had."""

    def __init__(self, owner: type, name: str) -> None:
        self.seconds, self.calls, self.owner = 0.0, 0, cast(Any, None)
        method = getattr(owner, name)

        @wraps(method)
        def timed(this: Any, *arguments: Any, **options: Any) -> Any:
            self.owner, start = this, process_time()
            self.calls += 1
            try:
                return method(this, *arguments, **options)
            finally:
                self.seconds += process_time() - start

        setattr(owner, name, timed)


def _peak() -> int:
    """Return the peak of this process' memory so far [B]."""
    return 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
