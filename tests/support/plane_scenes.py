"""Scenes of two dimensions: a rectangle of its own mesh, and runs that converge."""

from __future__ import annotations

from gmsh_files import section

import fem_snh

TIGHT = {"snes_scaled_tol": 1e-12}


def solve(scene, comm=None, **parameters):
    if comm is not None:
        parameters["comm"] = comm
    result = fem_snh.run(scene, progress=False, **parameters)
    assert result.converged, result.status
    return result


def write_mesh(path, triangles, order=1):
    """A rectangle 0 <= x <= 1/2, 0 <= y <= 1 with the groups bottom, side, top and body."""
    with section(path, order) as (geo, curves, surfaces):
        for number, (x, y) in enumerate([(0, 0), (0.5, 0), (0.5, 1), (0, 1)], 1):
            geo.addPoint(x, y, 0, 0.3, number)
        for number in range(1, 5):
            geo.addLine(number, number % 4 + 1, number)
        surface = geo.addPlaneSurface([geo.addCurveLoop([1, 2, 3, 4])])
        for line in (1, 3):
            geo.mesh.setTransfiniteCurve(line, 3)
        for line in (2, 4):
            geo.mesh.setTransfiniteCurve(line, 4)
        geo.mesh.setTransfiniteSurface(surface)
        if not triangles:
            geo.mesh.setRecombine(2, surface)
        curves |= {"bottom": [1], "side": [2], "top": [3]}
        surfaces["body"] = [surface]


SCENE = """
mesh = "mesh.msh"
element = "{element}"
kinematics = "{kinematics}"
steps = 2
reactions = ["bottom"]
volumes = ["body"]
fields = ["cauchy_stress", "reaction_force"]
[material]
name = "stable_neo_hookean"
E = 1.0
nu = 0.45
density = 2.0
[[hold]]
group = "bottom"
components = ["y", "z"]
"""


def own_scene(folder, element, kinematics, more, triangles=False, order=1):
    write_mesh(folder / "mesh.msh", triangles, order)
    path = folder / "own.toml"
    path.write_text(SCENE.format(element=element, kinematics=kinematics) + more)
    return path
