"""The indicator of locking, against how many times too stiff a body is."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from mpi4py import MPI

from benchmarks import Row, split_list
from fem_snh import solver
from fem_snh._petsc import default_options
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.problem.problem import Problem
from fem_snh.problem.state_notes import REPLACEMENTS, locking_note, may_lock, pressure_oscillation
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
        ``oscillation``: the indicator; ``factor``: how many times stiffer than a run of the
        replacement, by their energies; ``note``: whether a run has a note on locking.
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
    """Return the indicator and the factor of an element in the last state of a scene."""
    with solved(scene, values, name) as (setup, done):
        problem = setup.problem
        measured = {
            "oscillation": pressure_oscillation(problem, may_lock(problem)),
            "note": locking_note(problem) is not None,
        }
        own = energies(problem)
    with solved(scene, values, REPLACEMENTS[name]) as (setup, converged):
        other = energies(setup.problem)
    factor = 1 + (own[0] - other[0]) / min(own[1], other[1])
    return measured | {"factor": factor, "converged": done and converged}


def energies(problem: Problem) -> tuple[float, float]:
    """Return the energies of all terms and of the material [J], less those at rest. Collective."""
    at_rest = problem.x.duplicate()
    at_rest.set(0.0)
    rest = problem.elastic.energy(*problem.split(at_rest))
    energy = problem.energy(problem.x)
    return energy - rest, problem.elastic.energy(*problem.split(problem.x)) - rest


@contextmanager
def solved(scene: str, values: Row, element: str) -> Iterator[tuple[Setup, bool]]:
    """Yield a scene that is solved, and whether all of its steps converged."""
    chosen = load(scene, element=element, **values)
    with default_options(solver.PREFIX, chosen.petsc):
        setup = set_up(MPI.COMM_WORLD, chosen)
        converged = all([row["converged"] for row in setup.stepper])
        yield setup, converged
        setup.destroy()
