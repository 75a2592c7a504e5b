"""Time of writing stresses and strains, relative to one iteration of Newton's method."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

from mpi4py import MPI

import numpy as np

from benchmarks import Row, split_list
from fem_snh import _dolfinx, scenes
from fem_snh.errors import on_root
from fem_snh.records.output_fields import LOCATIONS, ON_REQUEST
from fem_snh.runs.output.field_values import RequestedFields
from fem_snh.runs.output.fields import Fields
from fem_snh.runs.setup import set_up

#: Limit on the time that all fields add to the output of a state, in Newton iterations.
LIMIT = 1.0


def rows(
    elements: str = "P1,P2,P2P0,P2P1,Q1,Q1P0,Q2,Q2Q1",
    cells: int = 0,
    fields: str = "",
    repeat: int = 5,
) -> Iterator[Row]:
    """Yield a row per element and location: the twist's first quarter turn, then its output.

    Parameters
    ----------
    elements : str
        Comma list.
    cells : int
        Along the edge; default: 15, and 7 for elements of degree 2.
    fields : str
        Comma list; default: all.
    repeat : int
        States written of each kind, in turns; the medians are compared.
    """
    names = split_list(fields) or list(ON_REQUEST)
    for element in split_list(elements):
        yield from measure(element, cells or (7 if "2" in element else 15), names, repeat)


def measure(element: str, cells: int, names: list[str], repeat: int) -> Iterator[Row]:
    """Yield the rows of an element: processor times, summed over the ranks. Collective."""
    comm = MPI.COMM_WORLD
    options = {"cells": cells, "element": element, "angle": np.pi / 4, "steps": 1}
    setup = set_up(comm, scenes.load("twist", **options))
    (step,) = setup.stepper
    problem = setup.problem
    newton = comm.allreduce(setup.stepper.processor) / step["newton"]
    scenes_of = {"": setup.scene}
    for at in LOCATIONS:
        scenes_of[at] = setup.scene.model_copy(update={"fields": names, "fields_at": at})
    taken: dict[str, list[float]] = {kind: [] for kind in scenes_of}
    values = {at: RequestedFields(problem, names, at, {}) for at in LOCATIONS}
    evaluated: dict[str, list[float]] = {at: [] for at in LOCATIONS}
    with TemporaryDirectory() as own:
        folder = Path(comm.bcast(own, root=0))
        outputs = {
            kind: Fields(folder / f"fields_{kind}.pvd", replace(setup, scene=chosen))
            for kind, chosen in scenes_of.items()
        }
        for state in range(repeat + 1):
            problem.load = 1.0 + state  # a series skips a load that it has
            for kind, output in outputs.items():
                start = process_time()
                output.write(problem)
                taken[kind].append(comm.allreduce(process_time() - start))
                # Writing new files to memory that the kernel has used before: the first use of a
                # page in a virtual machine takes several times as long as the copy.
                on_root(comm, remove_pieces, folder)
            for at in LOCATIONS:
                start = process_time()
                values[at].arrays()
                evaluated[at].append(comm.allreduce(process_time() - start))
        comm.barrier()
    seconds, computed = (
        {kind: float(np.median(measured[1:])) for kind, measured in times.items()}  # first: warm
        for times in (taken, evaluated)
    )
    for at in LOCATIONS:
        added = seconds[at] - seconds[""]
        row: Row = {
            "element": element,
            "cells": problem.num_cells,
            "ranks": comm.size,
            "fields": len(names),
            "at": at,
            "dolfinx": _dolfinx.version,
            "newton_ms": round(1e3 * newton, 2),
            "output_ms": round(1e3 * seconds[""], 2),
            "added_ms": round(1e3 * added, 2),
            "written_ms": round(1e3 * (added - computed[at]), 2),
            "newton_iterations": round(added / newton, 2),
            "limit": LIMIT,
            "ok": bool(added <= LIMIT * newton),
        }
        yield row


def remove_pieces(folder: Path) -> None:
    """Remove the files of the states written so far."""
    for file in folder.glob("*.vtu"):
        file.unlink()
