"""Scenes of two dimensions: exact solutions, the same problems as bodies, curves of forces."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import fem_snh
from benchmarks import Row, split_list
from fem_snh.errors import BadInput
from fem_snh.scenes.builtin.seal import SECTOR

#: Radial displacements of the tube's radii at rest, of the exact solution.
TUBE = {"inner": 0.5, "outer": 5.25**0.5 - 2}
#: Poisson's ratios of the O-ring, and squeezes with the widths of grooves that it touches.
NUS = (0.499, 0.4999)
GROOVES = ((0.3, 2.4), (0.5, 3.2))


def rows(parts: str = "tube,cook,stretch,bushing,seal", finest: int = 16) -> Iterator[Row]:
    """Yield one row per run of each part; ``seconds`` are those of the steps.

    Yields
    ------
    dict
        ``part`` and the options of the run; of the tube the largest error of two radial
        displacements, of the others the values that are compared.
    """
    known = {"tube": tube, "cook": cook, "stretch": stretch, "bushing": bushing, "seal": seal}
    for part in split_list(parts):
        if part not in known:
            raise BadInput(f"parts = '{part}': expected some of {', '.join(known)}")
        for row in known[part](finest):
            yield {"part": part} | row


def solved(scene: str, warm: bool = False, **options: Any) -> tuple[list[dict[str, Any]], Row]:
    """Return the rows of the steps of a run that converges, and its size and cost.

    A ``warm`` one is the second of two: the first of a process loads kernels and libraries.
    """
    for _ in range(1 + warm):
        result = fem_snh.run(scene, progress=False, **options)
    if not result.converged:
        raise BadInput(f"{scene} {options}: {result.status}")
    steps = result.steps
    cost = {
        "newton": sum(step["newton"] for step in steps),
        "seconds": round(sum(step["seconds"] for step in steps), 3),
    }
    return steps, {"dofs": result.record["dofs"]} | cost


def tube(finest: int) -> Iterator[Row]:
    """Yield the errors of the inflated tube over the cells through its wall."""
    for kinematics in ("axisymmetric", "plane_strain"):
        for cells in powers(2, finest):
            steps, cost = solved(
                "tube", cells=cells, kinematics=kinematics, petsc={"snes_scaled_tol": 1e-12}
            )
            probes = steps[-1]["probes"]
            error = max(abs(probes[name][0] - exact) for name, exact in TUBE.items())
            yield {"kinematics": kinematics, "cells": cells, "error": error} | cost


def cook(finest: int) -> Iterator[Row]:
    """Yield Cook's membrane in plane strain and as a layer: the displacement of its tip."""
    for element in ("Q1", "Q2", "Q1P0"):
        for kinematics in ("layer", "plane_strain"):
            steps, cost = solved(
                "cook", True, cells=finest, element=element, kinematics=kinematics, nu=0.49,
                petsc={"snes_scaled_tol": 1e-12},
            )  # fmt: skip
            tip = steps[-1]["probes"]["tip"][1]
            yield {"element": element, "kinematics": kinematics, "tip": tip} | cost


def stretch(finest: int) -> Iterator[Row]:
    """Yield the stretch to 3.4: sections over their meshes, bodies of straight and curved cells."""
    for nu in (0.3, 0.49, 0.4999):
        element = "Q2" if nu < 0.4 else "Q2Q1"
        runs: list[tuple[str | None, int, int]] = []
        runs += [("axisymmetric", n, 1) for n in (*powers(4, finest // 2), *range(10, 15, 2))]
        runs += [("axisymmetric", n, 1) for n in powers(finest, 4 * finest)]
        runs += [(None, n, 1) for n in (8, 10, 12)] + [(None, n, 2) for n in (6, 8)]
        for kinematics, cells, order in runs:
            keys = {"cells": cells, "element": element, "nu": nu, "order": order}
            steps, cost = solved("stretch", True, kinematics=kinematics, **keys)
            force = steps[-1]["reactions"]["right"][1 if kinematics else 0]
            row = {"nu": nu, "kinematics": kinematics, "element": element, "cells": cells}
            yield row | {"order": order} | {"force": force} | cost


def bushing(finest: int) -> Iterator[Row]:
    """Yield the bushing under torsion and tension: force and torque of sections and of bodies."""
    runs = [("axisymmetric_torsion", n) for n in powers(1, finest)]
    for kinematics, cells in runs + [("3D", n) for n in (1, 2, 4)]:
        steps, cost = solved("bushing", cells=cells, kinematics=kinematics)
        force, torque = steps[-1]["reactions"]["inner"][1], steps[-1]["moments"]["inner"][1]
        yield {"kinematics": kinematics, "cells": cells, "force": force, "torque": torque} | cost


def seal(finest: int) -> Iterator[Row]:
    """Yield the force on the O-ring over its squeeze: between plates, in grooves, of a body."""
    plates = [("axisymmetric", nu, n, 0.5, None) for nu in NUS for n in (finest // 2, finest)]
    grooves = [("axisymmetric", nu, finest, *pair) for nu in NUS for pair in GROOVES]
    cords = [("plane_strain", nu, finest, 0.5, groove) for nu in NUS for groove in (None, 3.2)]
    bodies = [(k, 0.499, finest // 2, 0.3, None) for k in ("axisymmetric", "3D")]
    for kinematics, nu, cells, squeeze, groove in plates + grooves + cords + bodies:
        steps, cost = solved(
            "seal", kinematics=kinematics, nu=nu, cells=cells, squeeze=squeeze, groove=groove,
            steps=round(20 * squeeze),
        )  # fmt: skip
        turn = {"3D": 360 / SECTOR, "plane_strain": 2}.get(kinematics, 1)
        given = {"kinematics": kinematics, "nu": nu, "cells": cells, "groove": groove}
        for step in steps:
            force = -step["obstacles"]["upper"]["force"][1] * turn
            row = {"squeeze": step["load"] * squeeze, "force": force, "newton": step["newton"]}
            yield given | row | {"min_J": step["min_J"], "dofs": cost["dofs"], "all": cost}


def powers(first: int, last: int) -> list[int]:
    """Return first, 2 first, 4 first, ... up to last."""
    found = []
    while first <= last:
        found.append(first)
        first *= 2
    return found
