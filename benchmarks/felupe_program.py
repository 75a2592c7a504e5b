"""The twist of Smith et al. 2018 in FElupe: the program that the benchmark felupe_twist times.

It needs felupe and pypardiso alone, so that it may run in an environment of its own:
``python felupe_program.py CELLS QUARTER_TURNS SUBSTEPS``. It prints one JSON object.
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version
from time import perf_counter, process_time

import felupe
import numpy as np
import pypardiso

#: Young's modulus [Pa] and Poisson's ratio of the scene ``twist``.
E, NU = 1.0, 0.49


def solve(cells: int, quarters: int, substeps: int) -> dict[str, object]:
    """Twist a cube of cells^3 hexahedra by quarter turns; return Newton iterations and seconds."""
    mesh = felupe.Cube(n=cells + 1)
    field = felupe.FieldContainer([felupe.Field(felupe.RegionHexahedron(mesh), dim=3)])
    energy = felupe.NeoHooke(mu=E / (2 * (1 + NU)), bulk=E / (3 * (1 - 2 * NU)), parallel=True)
    body = felupe.SolidBody(energy, field)
    faces = {"bottom": felupe.Boundary(field[0], fz=0), "top": felupe.Boundary(field[0], fz=1)}
    arm = mesh.points[faces["top"].points] - [0.5, 0.5, 1.0]
    angles = np.pi / 2 * np.arange(1, substeps * quarters + 1) / substeps
    turned = [np.column_stack([_turn(arm[:, :2], angle), arm[:, 2]]) - arm for angle in angles]
    ramp = {faces["top"]: np.array([u.ravel() for u in turned])}
    step = felupe.Step(items=[body], ramp=ramp, boundaries=faces)

    newton: list[int] = []
    start, working = perf_counter(), process_time()
    status = "converged"
    try:
        for result in step.generate(x0=field, verbose=0, solver=pypardiso.spsolve):
            newton.append(int(result.iterations))
    except (ValueError, RuntimeError) as error:  # its Newton method did not converge
        status = " ".join(str(error).split())[:100]
    return {
        "newton": newton,
        "status": status,
        "turned": float(np.degrees(angles[len(newton) - 1])) if newton else 0.0,
        "seconds": perf_counter() - start,
        "processor_seconds": process_time() - working,
        "version": f"felupe {version('felupe')}, pypardiso {version('pypardiso')}",
    }


def _turn(x: np.ndarray, angle: float) -> np.ndarray:
    """Return points (n, 2) that are turned about the origin."""
    c, s = np.cos(angle), np.sin(angle)
    return x @ np.array([[c, s], [-s, c]])


if __name__ == "__main__":
    print(json.dumps(solve(*map(int, sys.argv[1:]))))
