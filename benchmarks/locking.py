"""The indicator of locking and the factor of one linear solve, against a nonlinear comparison."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial

from mpi4py import MPI

from benchmarks import Row, split_list
from fem_snh import solver
from fem_snh._petsc import default_options
from fem_snh.accuracy.state_checks import may_lock, pressure_oscillation
from fem_snh.accuracy.state_notes import REPLACEMENTS, locking_note
from fem_snh.accuracy.stiffness import energies, stiffness_factor
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.runs.setup import Setup, set_up
from fem_snh.scenes import load

#: Of a scene: Cook's membrane as the layer of cells that the page describes.
SETTINGS = {"cook": {"kinematics": "layer"}}


def rows(
    scenes: str = "cook,block,stretch,twist",
    elements: str = "P1,P2,Q1,Q2",
    nus: str = "0.3,0.45,0.49,0.499,0.4999",
    cells: str = "4,8",
) -> Iterator[Row]:
    """Yield one row per scene, element, Poisson's ratio and number of cells (degree 2: half).

    Yields
    ------
    dict
        ``oscillation``: the indicator; ``factor``: of one linear solve, null if it is not convex;
        ``true``: the same ratio with the energies of a nonlinear run of the replacement;
        ``note``: whether a run has a note on locking.
    """
    for scene in split_list(scenes):
        for name in split_list(elements):
            for nu in map(float, split_list(nus)):
                for number in map(int, split_list(cells)):
                    number //= ELEMENTS[name].degree
                    row = {"scene": scene, "element": name, "nu": nu, "cells": number}
                    values = {"nu": nu, "cells": number} | SETTINGS.get(scene, {})
                    yield row | compare(scene, values, name)


def compare(scene: str, values: Row, name: str) -> Row:
    """Return the indicator and the factors of an element in the last state of a scene."""
    with solved(scene, values, name) as (setup, done):
        problem, make = setup.problem, setup.make
        assert make is not None
        factor = partial(stiffness_factor, make=make)
        measured = {
            "oscillation": pressure_oscillation(problem, may_lock(problem)),
            "factor": factor(problem),
            "note": locking_note(problem, factor) is not None,
        }
        own = energies(problem)
    with solved(scene, values, REPLACEMENTS[name]) as (setup, converged):
        other = energies(setup.problem)
    true = 1 + (own[0] - other[0]) / min(own[1], other[1])
    return measured | {"true": true, "converged": done and converged}


@contextmanager
def solved(scene: str, values: Row, element: str) -> Iterator[tuple[Setup, bool]]:
    """Yield a scene that is solved, and whether all of its steps converged."""
    chosen = load(scene, element=element, **values)
    with default_options(solver.PREFIX, chosen.petsc):
        setup = set_up(MPI.COMM_WORLD, chosen)
        converged = all([row["converged"] for row in setup.stepper])
        yield setup, converged
        setup.destroy()
