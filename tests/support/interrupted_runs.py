"""Runs that stop before their last step, for the tests of --resume."""

from __future__ import annotations

from contextlib import contextmanager

from mpi4py import MPI

from running import record as record

import fem_snh
from fem_snh.steps.stepping import AdaptiveStepSize, StepSize

ALONE, ALL = MPI.COMM_SELF, MPI.COMM_WORLD


class CutOff(Exception):
    """An exception that no part of a run handles: it ends the run as a crash would."""


@contextmanager
def cut(steps):
    """End the run in this ``with`` block before it attempts step ``steps`` + 1."""
    ends, left = {kind: kind.end for kind in (StepSize, AdaptiveStepSize)}, [steps]

    def counted(end):
        def next_end(self, load, target):
            """The end of the next step: the stepper asks for it once before each attempt."""
            if not left[0]:
                raise CutOff
            left[0] -= 1
            return end(self, load, target)

        return next_end

    for kind, end in ends.items():
        kind.end = counted(end)
    try:
        yield
    except CutOff:
        pass
    finally:
        for kind, end in ends.items():
            kind.end = end


def solve(scene, comm=ALL, **options):
    """Run a scene on all ranks, or on the first one alone while the others wait."""
    try:
        if comm is ALL or ALL.rank == 0:
            return fem_snh.run(scene, comm=comm, progress=False, **options)
    finally:
        ALL.barrier()


#: At nu = 0.49 a mesh this coarse leaves the symmetric states, and the trust region is entered.
STRETCH = {"cells": 3, "steps": 5, "stretch": 2.0, "nu": 0.3}
