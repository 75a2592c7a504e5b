"""Exact shapes of XAO files: meshes, groups, levels, and files that are none.

`data/bush.xao` and `data/plate.xao` were written by gmsh 4.13: a tube of radii 10 and 16 mm, 20 mm
long, and a square of 20 with a quarter of a hole of radius 1 at its corner.
"""

from __future__ import annotations

from math import pi

from mpi4py import MPI

import numpy as np
import pytest
from paths import DATA
from running import solve

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.mesh import gmsh_input, mesh, mesh_checks
from fem_snh.runs.scene_options import identity

mpi = pytest.mark.mpi
BUSH = DATA / "bush.xao"


@mpi
@pytest.mark.parametrize("cells, error", [(4, 1e-4), (10, 1e-5)])
def test_a_tube_is_round(comm, cells, error):
    bush = mesh.read(comm, BUSH, cells)
    assert bush.cell == "tetrahedron" and bush.has_parts is False
    assert mesh.volume(bush.domain) == pytest.approx(pi * (16**2 - 10**2) * 20, rel=error)
    assert [group.label for group in bush.groups] == [
        "surface:outer", "surface:inner", "volume:rubber",
    ]  # fmt: skip
    assert comm.allreduce(mesh_checks.scaled_jacobian(bush.domain).min(), op=MPI.MIN) > 0.1
    data = mesh.gather(bush)
    if comm.rank == 0:
        for group, radius in zip(data.groups, (16, 10), strict=False):
            found = np.hypot(*data.x[np.unique(group.entities), :2].T)
            assert found == pytest.approx(radius, rel=1e-12)
            ends = np.sort(data.x[np.unique(group.entities), 2])[[0, -1]]
            assert ends == pytest.approx([0, 20], abs=1e-9)


def bush(**changes):
    """A tube whose inner face turns; with free ends the state is a pure shear in circles."""
    keys = {
        "name": "bush", "mesh": BUSH, "element": "P2", "cells": 4,
        "material": {"name": "stable_neo_hookean", "E": 2.6, "nu": 0.3},
        "hold": [{"group": "outer"}],
        "move": [{
            "group": "inner",
            "rotate": {"axis": (0, 0, 1), "through": (0, 0, 0), "angle": 1e-4},
        }],
        "reactions": [{"group": "inner", "about": (0, 0, 0)}],
    }  # fmt: skip
    return scenes.Scene(**(keys | changes))


@mpi
def test_the_torque_of_a_bush_is_known(comm):
    r"""The torque is :math:`4 \pi G l \varphi / (a^{-2} - b^{-2})`, of shear stresses alone."""
    result = solve(bush(accuracy={"goals": ["inner.moment.z"]}), comm)
    exact = 4 * pi * 1.0 * 20 * 1e-4 / (10**-2 - 16**-2)
    goal = result.goals["inner.moment.z"]
    assert goal["value"] == pytest.approx(exact, rel=5e-3)
    assert abs(goal["corrected"] - exact) < 0.5 * abs(goal["error"])


@mpi
def test_levels_mesh_the_shape_again(comm):
    """A hole in a plate in tension: Kirsch's displacement is 3 S a / E, that of this plate known.

    The value is that of 15,000 cells of degree 2, corrected (0.002 %).
    """
    scene = scenes.Scene(
        name="plate", mesh=DATA / "plate.xao", element="P2", kinematics="plane_stress",
        material={"name": "stable_neo_hookean", "E": 1e4, "nu": 0.3},
        hold=[
            {"group": "left", "components": ("x",)}, {"group": "bottom", "components": ("y",)},
        ],
        traction=[{"group": "right", "vector": (1, 0, 0)}],
        probe=[{"name": "side", "point": (1, 0, 0)}, {"name": "top", "point": (0, 1, 0)}],
        accuracy={"goals": ["side.x", "top.y"], "within": 0.003},
    )  # fmt: skip
    result = solve(scene, comm)
    found = result.record["accuracy"]
    assert found["reached"] and len(found["levels"]) == 2
    for name, exact in (("side.x", 3.02137e-4), ("top.y", -1.01658e-4)):
        assert found["levels"][1]["goals"][name]["corrected"] == pytest.approx(exact, rel=3e-4)
    assert exact == pytest.approx(-1e-4, rel=0.02)  # Kirsch's, of an infinite plate


def test_a_shape_has_default_cells_and_counts_by_its_content():
    scene = bush(cells=None)
    assert scene.cells == 10
    assert identity(scene)["mesh"].startswith("sha256 ")
    with pytest.raises(BadInput, match="element = 'Q1': expected one on tetrahedra"):
        bush(element="Q1")


TEXT = BUSH.read_text()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("\x7fELF", "this is not an XAO file: not well-formed"),
        ("<XAO/>", "expected a shape and its topology"),
        (TEXT.replace('format="BREP"', 'format="BREP" file="/etc/passwd"'), "BREP in the file"),
        (TEXT.replace('<face index="2"', '<other index="2"'), "3 faces, .*: its shape has 4, 6, 4"),
        (TEXT.replace('<element index="1"/>', '<element index="7"/>'), "'inner': it has no face 7"),
        (TEXT.replace('dimension="face"', 'dimension="shell"'), "expected one of vertex, .*shell"),
        (TEXT.replace('reference="11"', 'reference="4"'), "its faces: expected different numbers"),
        (TEXT.replace('tag="1"', 'tag="-1"'), "tag = '-1': expected a whole number"),
        (TEXT.replace("CASCADE Topology", "Topology"), "its shape has 0, 0, 0, 0"),
    ],
)
def test_files_that_are_none(tmp_path, text, message):
    (tmp_path / "part.xao").write_text(text)
    with pytest.raises(BadInput, match=message):
        gmsh_input.mesh_shape(str(tmp_path / "part.xao"))
