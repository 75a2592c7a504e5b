"""Scenes of two dimensions: built-in ones, files with own meshes, and what they refuse."""

from __future__ import annotations

from math import pi, sqrt

import numpy as np
import pytest
from plane_scenes import TIGHT, own_scene, solve, write_mesh

import fem_snh
from fem_snh.errors import BadInput


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["Q1", "Q1P0", "Q2", "Q2Q1"])
def test_cook_is_the_layer(element):
    """Nearly incompressible, by default settings: the same displacements, forces and energy."""
    common = {"cells": 4, "element": element, "nu": 0.49, "petsc": TIGHT}
    results = [solve("cook", kinematics=k, **common) for k in ("layer", "plane_strain")]
    rows = [result.steps[-1] for result in results]
    for name, value in rows[0]["probes"].items():
        assert np.allclose(rows[1]["probes"][name], value, rtol=0, atol=1e-9)
    assert rows[1]["reactions"]["left"][1] == pytest.approx(-100, rel=1e-6)
    assert rows[1]["energy"] == pytest.approx(rows[0]["energy"], rel=1e-10)


@pytest.mark.one_debian
def test_stretch_is_that_of_the_cylinder():
    """Both meshes are coarse; that of 3D has straight sides, so the stresses are compared."""
    common = {"cells": 6, "stretch": 1.5, "steps": 2, "element": "Q2", "nu": 0.4}
    found = [solve("stretch", kinematics=k, **common) for k in (None, "axisymmetric")]
    volumes = [result.problem.length**3 for result in found]
    assert volumes[1] == pytest.approx(pi / 4, rel=1e-12)
    solid, turned = (result.steps[-1] for result in found)
    stress = solid["reactions"]["right"][0] / volumes[0]
    assert turned["reactions"]["right"][1] / volumes[1] == pytest.approx(stress, rel=1e-2)
    assert turned["volume_ratio"] == pytest.approx(solid["volume_ratio"], rel=1e-3)
    along = solid["probes"]["axis"][0]
    assert turned["probes"]["axis"][1] == pytest.approx(along, rel=1e-2)
    assert abs(turned["probes"]["axis"][0]) < 1e-15
    radial = sum(solid["probes"]["inside"][1:]) / sqrt(2)
    assert turned["probes"]["inside"][0] == pytest.approx(radial, rel=2e-2)


TRACTION = """
[[traction]]
group = "top"
vector = [0, {traction!r}, 0]
"""


@pytest.mark.one_debian
@pytest.mark.parametrize(
    "element, triangles, order",
    [("Q1", False, 1), ("P2", True, 2), ("P2P1", True, 1), ("Q2", False, 2)],
)
def test_own_mesh_under_traction(tmp_path, element, triangles, order):
    """The rod's stretch is that of the closed form; the reaction is that of the whole turn."""
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.45)
    mu, lam, s = material.lame[0], sum(material.lame), 1.5
    J = 1 + mu / lam * (1 - 1 / s)
    P = mu * (s - J / s**2)
    more = TRACTION.format(traction=P) + "[petsc]\nsnes_scaled_tol = 1e-11\n"
    path = own_scene(tmp_path, element, "axisymmetric", more, triangles, order)
    row = solve(path, out=tmp_path / "out").steps[-1]
    assert row["reactions"]["bottom"][1] == pytest.approx(-P * pi / 4, rel=1e-9)
    assert row["volume_ratio"] == pytest.approx(J, rel=1e-9)
    assert row["volumes"]["body"] == pytest.approx(J, rel=1e-9)
    assert (tmp_path / "out" / "fields.pvd").is_file()


@pytest.mark.one_debian
def test_weight_and_spring_of_the_whole_turn(tmp_path):
    """Forces balance: the weight rho g V, and a spring's that holds it."""
    weight = "[gravity]\nvector = [0, -0.01, 0]\n"
    path = own_scene(tmp_path, "Q1", "axisymmetric", weight)
    row = solve(path).steps[-1]
    assert row["reactions"]["bottom"][1] == pytest.approx(0.02 * pi / 4, rel=1e-6)
    spring = '[[spring]]\ngroup = "top"\nstiffness = [0, 1e3, 0]\n'
    path = own_scene(tmp_path, "Q1", "axisymmetric", weight + spring)
    row = solve(path).steps[-1]
    assert 0.2 < row["reactions"]["bottom"][1] / (0.02 * pi / 4) < 0.8


@pytest.mark.parametrize(
    "keys, message",
    [
        ("", "missing key 'kinematics': expected one of plane_strain, plane_stress, axis"),
        ('kinematics = "axisymmetric_torsion"\nself_contact = {}',
         "'reference': expected no self-"),
        ('kinematics = "plane_strain"\naccuracy.goals = ["top.force.z"]',
         "accuracy.goals = 'top.force.z': expected a component x or y, with kinematics = 'plane"),
        ('kinematics = "axisymmetric"\naccuracy.goals = ["top.moment"]',
         "accuracy.goals = 'top.moment': expected another goal, with kinematics = 'axisym"),
        ('kinematics = "plane_strain"\n[[hold]]\ngroup = "top"\ncomponents = ["z"]',
         "some of x, y"),
        ('kinematics = "plane_strain"\n[[move]]\ngroup = "top"\ntranslate = [1, 0, 0.1]',
         r"move.0.translate = \[1.0, 0.0, 0.1\]: expected a motion without z"),
        (
            'kinematics = "axisymmetric"\n[[move]]\ngroup = "top"\n'
            "rotate = { axis = [0, 1, 0], angle = 1 }",
            r"move.0.rotate = 'about \[0.0, 1.0, 0.0\]': expected a motion without z",
        ),
        ('kinematics = "plane_strain"\n[[traction]]\ngroup = "top"\nvector = [0, 0, 1]',
         "traction.vector = .*2 components and zero"),
        ('kinematics = "axisymmetric"\n[gravity]\nvector = [1, -9.81, 0]',
         "gravity.vector = .*: expected a vector along the axis y, in axisymmetric"),
        ('kinematics = "axisymmetric_torsion"\n[gravity]\nvector = [0, 0, 9.81]',
         "gravity.vector = .*: expected a vector along the axis y, in axisymmetric_torsion"),
    ],
)  # fmt: skip
def test_what_scenes_refuse(tmp_path, keys, message):
    write_mesh(tmp_path / "mesh.msh", False)
    text = 'mesh = "mesh.msh"\nelement = "Q1"\n' + keys
    text += '\n[material]\nname = "stable_neo_hookean"\nE = 1.0\nnu = 0.4\ndensity = 1.0\n'
    (tmp_path / "own.toml").write_text(text)
    with pytest.raises(BadInput, match=message):
        solve(tmp_path / "own.toml")
