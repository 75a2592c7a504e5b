"""Exact solutions of incompressible finite strain: uniaxial, plane strain, Rivlin's torsion."""

from __future__ import annotations

from collections.abc import Iterator
from math import pi, sqrt
from typing import Any

from mpi4py import MPI

import numpy as np
from scipy.optimize import brentq

from benchmarks import Row
from benchmarks.references.compare import TIGHT, compare, solve
from fem_snh.problem.problem import Problem
from fem_snh.scenes import (
    Geometry,
    Hold,
    MaterialChoice,
    Move,
    Probe,
    Reaction,
    Rotate,
    Scene,
    Traction,
)

#: Planes of symmetry of the unit cube.
SYMMETRY = [
    Hold(group="left", components=("x",)),
    Hold(group="front", components=("y",)),
    Hold(group="bottom", components=("z",)),
]
CORNER = Probe(name="corner", point=(1, 1, 1))


def _of_shear_modulus(mu: float, lame: float = np.inf) -> dict[str, float]:
    """Return E and nu for the Lamé constants."""
    nu = 0.5 if np.isinf(lame) else lame / (2 * (lame + mu))
    return {"E": 2 * mu * (1 + nu), "nu": nu}


def uniaxial(elements: str = "P2P1,Q2Q1") -> Iterator[Row]:
    """Yield a cube stretched to twice its length (scikit-fem ex36), then at nu = 1/2."""
    for element in elements.split(","):
        for lame in (1e4, np.inf):
            constants: dict[str, Any] = _of_shear_modulus(1.0, lame)
            scene = Scene(
                name="uniaxial",
                mesh=Geometry(source="cube"),
                cells=2,
                element=element,
                steps=2,
                material=MaterialChoice(name="neo_hookean_ogden", **constants),
                hold=SYMMETRY,
                move=[Move(group="right", translate=(1, 0, 0), components=("x",))],
                reactions=[Reaction(group="right")],
                probe=[CORNER],
            )
            _, step = solve(scene, petsc=TIGHT)
            of = f"{element}, " + ("nu = 0.5" if np.isinf(lame) else "lambda/mu = 1e4")
            source, near = "scikit-fem ex36", 0.01 if np.isfinite(lame) else 1e-6
            J = step and step["volume_ratio"]
            # P_xx = mu s + p J/s at the stretch s = 2.
            p = step and (step["reactions"]["right"][0] - 2) * 2 / J
            yield compare(f"pressure [mu], {of}", source, -0.5, p, 1e-6)
            yield compare(f"volume, {of}", source, 1.0, J, near)
            lateral = step and step["probes"]["corner"][1]
            yield compare(f"u_y, {of}", source, sqrt(0.5) - 1, lateral, near)


def _mooney_rivlin(C1: float, C2: float) -> MaterialChoice:
    """Return the incompressible material with these constants [Pa]."""
    constants: dict[str, Any] = _of_shear_modulus(2 * (C1 + C2))
    if not C2:
        return MaterialChoice(name="neo_hookean_ogden", **constants)
    return MaterialChoice(name="mooney_rivlin", **constants | {"C1": C1})


def plane_strain(elements: str = "P2P1,Q2Q1", force: float = -1.0) -> Iterator[Row]:
    """Yield an incompressible Mooney-Rivlin cube under a dead load in plane strain.

    F = 2 S (C1 + C2) (s - 1/s^3), s = 1 + w the stretch along it.
    """
    C1, C2 = 0.25, 0.125
    w = brentq(lambda w: 2 * (C1 + C2) * ((1 + w) - (1 + w) ** -3) - force, -0.9, 9)
    for element in elements.split(","):
        scene = Scene(
            name="plane_strain",
            mesh=Geometry(source="cube"),
            cells=2,
            element=element,
            steps=2,
            material=_mooney_rivlin(C1, C2),
            hold=[*SYMMETRY, Hold(group="back", components=("y",))],
            traction=[Traction(group="top", vector=(0, 0, force))],
            probe=[CORNER],
        )
        _, step = solve(scene, petsc=TIGHT)
        ux, _, uz = step["probes"]["corner"] if step else (None, None, None)
        of = f"F = {force:g}, {element}, nu = 0.5"
        yield compare(f"w, {of}", "code_aster V6.04.187", w, uz, 1e-6)
        yield compare(f"u_x = -w/(1 + w), {of}", "code_aster V6.04.187", -w / (1 + w), ux, 1e-6)


#: C1 and C2 [Pa]; mu = 1 Pa.
RUBBERS = {"Neo-Hookean": (0.5, 0.0), "Mooney-Rivlin": (0.375, 0.125)}
#: Cells along the diameter. With 3, 4, 6, 8, 10 of them P2P1's axial force is 16, 9, 1.8, 0.7 and
#: 0.3 % too large; Q2Q1's with 4, 6, 8 is 0.3, 0.07, 0.01 %.
TWISTED = {"P2P1": 8, "Q2Q1": 6}


def torsion(elements: str = "P2P1,Q2Q1", cells: int = 0, angle: float = pi / 2) -> Iterator[Row]:
    """Yield a cylinder of radius and length 1 twisted at constant length with free sides.

    Sections rotate rigidly. With tau the angle per length, the torque is pi (C1 + C2) tau R^4 and
    the ends are compressed by pi (C1/2 + C2) tau^2 R^4 (the Poynting effect).
    """
    for rubber, (C1, C2) in RUBBERS.items():
        for element in elements.split(","):
            scene = Scene(
                name="torsion",
                mesh=Geometry(
                    source="cylinder", parameters={"radius": 1.0, "length": 1.0, "order": 2}
                ),
                cells=cells or TWISTED[element],
                element=element,
                steps=2,
                material=_mooney_rivlin(C1, C2),
                hold=[Hold(group="left")],
                move=[Move(group="right", rotate=Rotate(axis=(1, 0, 0), angle=angle))],
                reactions=[Reaction(group="right")],
            )
            result, step = solve(scene)
            torque = step and torque_at(result.problem, 1.0)
            force = step and step["reactions"]["right"][0]
            of = f"{rubber}, tau R = {angle:.3f}, {element}, nu = 0.5"
            source = "Rivlin 1949"
            yield compare(f"torque, {of}", source, pi * (C1 + C2) * angle, torque, 0.5)
            pressed = -pi * (C1 / 2 + C2) * angle**2
            yield compare(f"axial force, {of}", source, pressed, force, 1.0)


def torque_at(problem: Problem, x: float) -> float:
    """Return the torque about the x axis [N m] on the nodes at X_0 = ``x``. Collective."""
    gradient = problem.x.duplicate()
    problem.gradient(problem.x, gradient)
    X = problem.coordinates
    there = X + problem.u.x.array[: X.size].reshape(-1, 3)
    forces = gradient.array_r[: X.size].reshape(-1, 3)
    fixed_end = np.isclose(X[:, 0], x)
    mine = np.cross(there[fixed_end], forces[fixed_end])[:, 0].sum()
    return float(problem.comm.allreduce(mine, op=MPI.SUM))
