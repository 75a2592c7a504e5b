"""The buckling cylinder of LLNL's Smith (formerly Serac), ``examples/buckling``, without contact.

A hollow cylinder, radii 0.75 and 1, length 4, lambda = 1, G = 0.1, Neo-Hookean with log J. One end
is fixed; the other moves by 1.35 obliquely, (-1, 0, -1)/sqrt(2), and a pressure of 0.01 acts on the
inner surface where x > 0. Its mesh has 96 x 6 x 48 hexahedra and 98,784 unknowns; it takes ten
pseudo-time steps and, once the walls are close, steps of a hundredth. The problem is symmetric
about y = 0: this is half of it. No counts of iterations are published.
"""

from __future__ import annotations

from math import pi, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

import fem_snh
from benchmarks import Row
from benchmarks.graded_meshes import Array, at, write
from fem_snh.scenes import Scene

#: The name of the scene.
NAME = "cylinder"
#: Smith's constants, lengths and displacement.
LAMBDA, SHEAR, LENGTH, RADII, MOVED, PRESSURE = 1.0, 0.1, 4.0, (0.75, 1.0), 1.35, 0.01
#: Cells around half of the cylinder, through its wall, along it: those of Smith's mesh.
CELLS = (48, 6, 48)


def row(steps: int = 10) -> Row:
    """Return Newton and linear iterations and seconds of the load steps."""
    axes = [np.linspace(0, end, n + 1) for end, n in zip((1, 1, 1), CELLS, strict=True)]

    def mapping(s: Array) -> Array:
        radius, angle = RADII[0] + (RADII[1] - RADII[0]) * s[:, 1], pi * s[:, 0]
        return np.column_stack([-radius * np.cos(angle), radius * np.sin(angle), LENGTH * s[:, 2]])

    sides = {
        "middle": lambda s: (s[:, 0] < 1e-9) | (s[:, 0] > 1 - 1e-9),
        "start": at(2, 0.0),
        "end": at(2, 1.0),
        "inner": lambda s: (s[:, 1] < 1e-9) & (s[:, 0] > 0.5),
    }
    oblique = -MOVED / sqrt(2)
    with TemporaryDirectory() as folder:
        path = Path(folder, "cylinder.msh")
        write(path, axes, sides, mapping=mapping)
        scene = {
            "name": NAME,
            "mesh": path,
            "element": "Q1",
            "steps": steps,
            "material": {
                "name": "neo_hookean",
                "E": SHEAR * (3 * LAMBDA + 2 * SHEAR) / (LAMBDA + SHEAR),
                "nu": LAMBDA / (2 * (LAMBDA + SHEAR)),
            },
            "hold": [{"group": "start"}, {"group": "middle", "components": ["y"]}],
            "move": [{"group": "end", "translate": (oblique, 0, oblique)}],
            "pressure": [{"group": "inner", "value": PRESSURE}],
        }
        result = fem_snh.run(Scene.model_validate(scene), progress=False)
    done = result.record["steps"]
    return {
        "peer": "fem_snh",
        "scene": NAME,
        "unknowns": result.problem.dofs,
        "steps": len(done),
        "newton": sum(step["newton"] for step in done),
        "linear": sum(step["linear"] for step in done),
        "seconds": round(sum(step["seconds"] for step in done), 2),
        "smallest_J": done[-1]["min_J"],
        "load": done[-1]["load"],
        "status": result.status,
    }
