"""Newton iterations of the Hessian filters, element by element, from rough initial guesses."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, pi
from statistics import median

from mpi4py import MPI

import numpy as np

from benchmarks import Row, policy, split_list
from fem_snh import solver
from fem_snh.assembly.elements import ELEMENTS, element
from fem_snh.assembly.regions import Filling
from fem_snh.errors import choose
from fem_snh.kernels.material import material
from fem_snh.linalg.direct_solver import set_direct_solver
from fem_snh.mesh import mesh
from fem_snh.problem.definition import Definition
from fem_snh.scenes import Hold, Move, Rotate

#: Displacement of the right face of the unit cube, in one step: stretch to twice the length,
#: compression to 0.6, a quarter turn, or a shift by half the length.
CASES = {
    "stretch": Move(group="right", translate=(1, 0, 0)),
    "press": Move(group="right", translate=(-0.4, 0, 0)),
    "twist": Move(
        group="right", rotate=Rotate(axis=(1, 0, 0), angle=pi / 2, through=(0, 0.5, 0.5))
    ),
    "shear": Move(group="right", translate=(0, 0, 0.5)),
}
#: Limit on the Newton iterations of a solve.
MAX_IT = 150


def rows(
    elements: str = "Q1,Q1P0,Q2,Q2Q1",
    cases: str = ",".join(CASES),
    nus: str = "0.3,0.49,0.4999",
    cells: str = "2,3",
    seeds: int = 5,
    noise: float = 0.3,
    hessians: str = "clamp,abs,adaptive",
) -> Iterator[Row]:
    """Yield one row per element, case, nu and mesh. Linear systems are solved directly.

    Parameters
    ----------
    cells : str
        Along an edge, for elements of degree 2; those of degree 1 have twice as many.
    noise : float
        Size of the random displacement of every node that is the initial guess, in cell sizes; it
        inverts cells.

    Yields
    ------
    dict
        ``newton``: the median over the seeds by filter; None where most seeds reached MAX_IT.
        ``failed``: number of seeds that did. ``better``: seeds for which abs took fewer iterations
        than clamp. ``states``: number of different final energies.
    """
    for name in split_list(elements):
        for case in split_list(cases):
            for nu in split_list(nus):
                for n in split_list(cells):
                    yield compare(name, case, float(nu), int(n), seeds, noise, split_list(hessians))


def compare(
    name: str, case: str, nu: float, cells: int, seeds: int, noise: float, hessians: list[str]
) -> Row:
    """Return the row of an element, case, nu and mesh."""
    many = cells * (3 - element(name).degree)
    counts: dict[str, list[float]] = {}
    energies = []
    for hessian in hessians:
        found = [solve(name, case, nu, many, seed, noise, hessian) for seed in range(seeds)]
        counts[hessian] = [count for count, _ in found]
        energies += [energy for count, energy in found if isfinite(count)]
    row: Row = {"element": name, "case": case, "nu": nu, "cells": many, "seeds": seeds}
    middle = {key: median(values) for key, values in counts.items()}
    row["newton"] = {key: value if isfinite(value) else None for key, value in middle.items()}
    row["failed"] = {key: sum(map(np.isinf, values)) for key, values in counts.items()}
    row["failed"] = {key: int(value) for key, value in row["failed"].items()}
    if {"clamp", "abs"} <= set(counts):
        pairs = zip(counts["abs"], counts["clamp"], strict=True)
        row["better"] = sum(a < c for a, c in pairs)
    return row | {"states": len({round(energy, 6) for energy in energies})}


def solve(
    name: str, case: str, nu: float, cells: int, seed: int, noise: float, hessian: str
) -> tuple[float, float]:
    """Return the Newton iterations (infinite without convergence) and the energy of one seed."""
    kind = ELEMENTS[choose("element", name, ELEMENTS)]
    body = mesh.generate(MPI.COMM_SELF, "cube", kind.cell, cells=cells)
    snh = material("stable_neo_hookean", E=1.0, nu=nu)
    p = Definition(
        body, kind, [Filling(snh)], [Hold(group="left"), CASES[choose("case", case, CASES)]]
    ).problem()
    n = p.u.x.array.size
    p.x.array[:n] = noise / cells * np.random.default_rng(seed).uniform(-1, 1, n)
    p.set_load(1.0)
    p.prescribe(p.x)
    snes = solver.create(p, **policy(hessian))
    snes.setTolerances(max_it=MAX_IT)
    set_direct_solver(snes.getKSP())
    snes.solve(None, p.x)
    good = snes.getConvergedReason() > 0
    return (snes.getIterationNumber() if good else float("inf")), p.energy(p.x)
