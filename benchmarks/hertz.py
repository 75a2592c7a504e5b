"""Hertz's contact: force, radius and pressure beside the theory, by body, stiffness and mesh.

Limits: the force within 2 % at depth 0.2 and 3 % at 0.5, the contact radius within 7 %; at depth 2
(code_aster's SSNV104) radius and peak pressure within 10 %. Hertz's theory is that of a half-space,
where both methods have these limits. An elastic ball is stiffer: without the penalty's penetration
its force is compared with that of the series for a ball, within 0.5 %.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from math import pi, sqrt
from typing import Any

import numpy as np

from benchmarks import Row, split_list
from benchmarks.pressed_ball import force_ratio
from fem_snh.errors import choose
from fem_snh.runs import run
from fem_snh.scenes import load
from fem_snh.scenes.builtin.hertz import FAR, MODULUS, RADIUS, RATIO

#: Depth [mm] -> limits of the errors of force, radius and peak pressure, for the default settings.
LIMITS = {0.2: (0.02, 0.07, 1.0), 0.5: (0.03, 0.07, 1.0), 2.0: (1.0, 0.1, 0.1)}

#: The names of the bodies.
BODIES = ("ball", "half_space")
#: Depths [mm] and limit for the error of the force in that of an elastic ball.
BALL_DEPTHS, BALL_LIMIT = (0.2, 0.5), 0.005
#: Tolerance of the augmented Lagrangian in the depth; a scene's is relative to V^(1/3).
TOLERANCE = 1e-3


def rows(
    depths: str = "0.2,0.5,2",
    cells: str = "6,8,12",
    elements: str = "P2",
    factors: str = "1",
    method: str = "penalty",
    bodies: str = BODIES[0],
) -> Iterator[Row]:
    """Compare with Hertz's theory.

    Parameters
    ----------
    depths : str
        Depths of the plane [mm].
    cells : str
        Cells along 1.25 contact radii.
    elements : str
        Elements.
    factors : str
        Stiffnesses of contact, as multiples of the default.
    method : str
        penalty or augmented_lagrangian.
    bodies : str
        Of `BODIES`: an elastic ball on a rigid plane, or a half-space under a rigid ball.
    """
    for body, depth in product(split_list(bodies), map(float, split_list(depths))):
        for element in split_list(elements):
            for resolution in map(int, split_list(cells)):
                for factor in map(float, split_list(factors)):
                    yield measure(body, depth, element, resolution, factor, method)


def measure(body: str, depth: float, element: str, cells: int, factor: float, method: str) -> Row:
    """Return a run's force, radius and peak pressure over those of Hertz, and its cost."""
    import fem_snh.contact.law as module

    default, module.FACTOR = module.FACTOR, module.FACTOR * factor
    try:
        half_space = choose("bodies", body, BODIES) == "half_space"
        scene = load("hertz", cells=cells, depth=depth, element=element, half_space=half_space)
        table = scene.obstacle[0].model_copy(update={"method": method})
        if table.augmented:
            size = RADIUS * (FAR if half_space else 1)
            tolerance = TOLERANCE * depth / (size * (pi / 6) ** (1 / 3))
            table = table.model_copy(update={"tolerance": tolerance})
        result = run(scene.model_copy(update={"obstacle": [table]}), progress=False)
    finally:
        module.FACTOR = default
    step, modulus, radius = (
        result.record["steps"][-1],
        MODULUS / (1 - RATIO**2),
        sqrt(RADIUS * depth),
    )
    (found,) = step["obstacles"].values()
    area, peak = contact_area(result.problem)
    ratios = (
        4 * abs(found["force"][2]) / (4 / 3 * modulus * sqrt(RADIUS) * depth**1.5),
        sqrt(4 * area / pi) / radius,
        peak / (2 * modulus * radius / (pi * RADIUS)),
    )
    row = {
        "body": body,
        "depth": depth,
        "element": element,
        "cells": cells,
        "method": method,
        "factor": factor,
        "dofs": result.problem.dofs,
        "newton": step["newton"],
        "linear": step["linear"],
        "solves": result.steps[-1]["solves"],
        "penetration": found["penetration"] / depth,
        **dict(zip(("force", "radius", "peak_pressure"), ratios, strict=True)),
    }
    limits = LIMITS.get(depth)
    if method != "penalty" and not half_space:
        row["ball"] = force_ratio(depth / RADIUS, RATIO)
        if depth in BALL_DEPTHS:
            row["ok"] = abs(ratios[0] / row["ball"] - 1) <= BALL_LIMIT
    elif limits and factor == 1 and element == "P2" and cells == 6:
        row["ok"] = all(abs(r - 1) <= e for r, e in zip(ratios, limits, strict=True))
    return {key: float(f"{v:.4g}") if isinstance(v, float) else v for key, v in row.items()}


def contact_area(problem: Any) -> tuple[float, float]:
    """Return the reference area in contact [mm^2] and the largest nodal pressure [MPa]."""
    term = next(term for term in problem.terms if term.name == "obstacle")
    u = problem.split(problem.x)[0]
    pressure = term.nodal_field("contact_pressure", u)
    at = term.pairs[0].points(u.array_r.reshape(-1, 3))
    area = term.surface.weights[at.which][at.pressure > 0].sum()
    sums = problem.comm.allreduce(float(area))
    return sums, max(problem.comm.allgather(float(np.max(pressure, initial=0.0))))
