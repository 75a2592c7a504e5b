"""Runs for tests, and the files that they leave."""

from __future__ import annotations

import csv
import json

from mpi4py import MPI

import fem_snh


def solve(scene="twist", comm=MPI.COMM_WORLD, **kwargs):
    return fem_snh.run(scene, comm=comm, progress=False, **kwargs)


def record(folder):
    return json.loads((folder / "run.json").read_text())


def rows(folder):
    with (folder / "steps.csv").open() as file:
        return list(csv.DictReader(file))
