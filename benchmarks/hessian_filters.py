"""The filters of the Hessian against each other, element by element, from rough starts."""

from __future__ import annotations

from collections.abc import Iterator
from math import isfinite, pi
from statistics import median

from mpi4py import MPI

import numpy as np

from benchmarks import Row, policy, split_list
from fem_snh import solver
from fem_snh.errors import choose
from fem_snh.fem import mesh
from fem_snh.fem.elements import ELEMENTS, element
from fem_snh.fem.problem import Problem
from fem_snh.kernels.pointwise import material
from fem_snh.linalg.direct_solver import set_direct_solver
from fem_snh.scenes import Hold, Move, Rotate

#: What becomes of the unit cube's right face, in one step: stretched to twice the length, pressed
#: to six tenths, turned by a right angle, or moved sideways by half of the length.
CASES = {
    "stretch": Move(group="right", translate=(1, 0, 0)),
    "press": Move(group="right", translate=(-0.4, 0, 0)),
    "twist": Move(
        group="right", rotate=Rotate(axis=(1, 0, 0), angle=pi / 2, through=(0, 0.5, 0.5))
    ),
    "shear": Move(group="right", translate=(0, 0, 0.5)),
}
#: Newton iterations after which a solve is given up.
MOST = 150


def rows(
    elements: str = "Q1,Q1P0,Q2,Q2Q1",
    cases: str = ",".join(CASES),
    nus: str = "0.3,0.49,0.4999",
    cells: str = "2,3",
    seeds: int = 5,
    noise: float = 0.3,
    hessians: str = "clamp,abs,adaptive",
) -> Iterator[Row]:
    """One row per element, case, nu and mesh: Newton iterations by filter, medians over seeds.

    Every node starts where a random displacement puts it, of ``noise`` cell sizes, so that cells
    are inverted; the linear systems are solved by factors. ``cells`` along an edge: of elements of
    order two; twice as many of order one.

    newton : the median, None where most seeds were given up after MOST.
    failed : seeds given up. better : seeds for which abs took fewer iterations than clamp.
    states : how many different energies the seeds and filters ended at.
    """
    for name in split_list(elements):
        for case in split_list(cases):
            for nu in split_list(nus):
                for n in split_list(cells):
                    yield compare(name, case, float(nu), int(n), seeds, noise, split_list(hessians))


def compare(
    name: str, case: str, nu: float, cells: int, seeds: int, noise: float, hessians: list[str]
) -> Row:
    """A row."""
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
    """(Newton iterations, infinite if there is no end; energy) of one start."""
    kind = ELEMENTS[choose("element", name, ELEMENTS)]
    body = mesh.generate(MPI.COMM_SELF, "cube", kind.cell, cells=cells)
    law = material("stable_neo_hookean", E=1.0, nu=nu)
    p = Problem(
        body, kind, law, hold=[Hold(group="left")], move=[CASES[choose("case", case, CASES)]]
    )
    n = p.u.x.array.size
    p.x.array[:n] = noise / cells * np.random.default_rng(seed).uniform(-1, 1, n)
    p.set_load(1.0)
    p.prescribe(p.x)
    snes = solver.create(p, **policy(hessian))
    snes.setTolerances(max_it=MOST)
    set_direct_solver(snes.getKSP())
    snes.solve(None, p.x)
    good = snes.getConvergedReason() > 0
    return (snes.getIterationNumber() if good else float("inf")), p.energy(p.x)
