"""A sheared and stretched section in FElupe: the program that felupe_sections compares with.

It needs felupe alone, so that it may run in an environment of its own:
``python felupe_section_program.py ELEMENT KINEMATICS CELLS``. It prints one JSON object, with the
coordinates and the displacements of the nodes, x the radius of a body of revolution.
"""

from __future__ import annotations

import json
import sys
from importlib.metadata import version

import numpy as np

#: Young's modulus [Pa] and Poisson's ratio.
E, NU = 1.0, 0.4
#: The displacement of the top of the unit square, of which the bottom is constrained.
MOVED = {"plane_strain": (0.3, 0.5), "axisymmetric": (0.1, 0.5)}
#: Load steps: its Newton method has no line search.
STEPS = 5
#: Newton's iterations end at this norm of the residual over that of the reactions.
TOLERANCE = 1e-12


def distort(x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the corners of cells from those of a unit square: moved to x = 1/2, distorted."""
    bump = 0.08 * np.sin(np.pi * x) * np.sin(np.pi * y)
    return 0.5 + x + bump, y - 0.7 * bump


def solve(element: str, kinematics: str, cells: int) -> dict[str, object]:
    """Return the nodes and the displacements of Q1 or Q2 in plane strain or axisymmetric."""
    import felupe  # here, as the benchmark reads the constants without it

    mesh = felupe.Rectangle(n=cells + 1)
    mesh.points[:] = np.column_stack(distort(*mesh.points.T))
    revolved = kinematics == "axisymmetric"
    if revolved:  # FElupe's first coordinate is that along the axis
        mesh.points[:] = mesh.points[:, ::-1]
        mesh.cells[:] = mesh.cells[:, [0, 3, 2, 1]]
    if element == "Q2":
        mesh = mesh.add_midpoints_edges().add_midpoints_faces()
        region = felupe.RegionBiQuadraticQuad(mesh)
    else:
        region = felupe.RegionQuad(mesh)
    kind = felupe.FieldAxisymmetric if revolved else felupe.FieldPlaneStrain
    field = felupe.FieldContainer([kind(region, dim=2)])
    body = felupe.SolidBody(felupe.NeoHooke(mu=E / 2 / (1 + NU), bulk=E / 3 / (1 - 2 * NU)), field)

    order = [1, 0] if revolved else [0, 1]
    axial = order.index(1)
    height = mesh.points[:, axial]
    ends = {"bottom": np.isclose(height, 0), "top": np.isclose(height, 1)}
    boundaries = {
        f"{name}_{i}": felupe.Boundary(field[0], mask=mask, skip=(i == 1, i == 0))
        for name, mask in ends.items()
        for i in range(2)
    }
    moved = np.array(MOVED[kinematics])[order]
    ramp = {boundaries[f"top_{i}"]: np.linspace(0, moved[i], STEPS + 1)[1:] for i in range(2)}
    step = felupe.Step(items=[body], ramp=ramp, boundaries=boundaries)
    for _ in step.generate(x0=field, verbose=0, tol=TOLERANCE):
        pass
    return {
        "points": mesh.points[:, order].tolist(),
        "displacements": field[0].values[:, order].tolist(),
        "version": f"felupe {version('felupe')}",
    }


if __name__ == "__main__":
    element, kinematics, cells = sys.argv[1:]
    print(json.dumps(solve(element, kinematics, int(cells))))
