"""Errors of bodies with bones and rigid parts that are shapes, whose surface no cell follows."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve

import fem_snh
from fem_snh.geometry.shapes import Box, Capsule, ClosedSurface, Cylinder, Sphere, Union
from fem_snh.geometry.shapes.triangles import has_edges, surface_triangles
from fem_snh.scenes import (
    Accuracy,
    BoneChoice,
    Geometry,
    Hold,
    MaterialChoice,
    Move,
    Probe,
    Rigid,
    Scene,
)
from fem_snh.tables.amplitudes import Rotate

mpi = pytest.mark.mpi

CENTRE = (0.47, 0.52, 0.55)
SPHERE = {"sphere": {"center": CENTRE, "radius": 0.22}}
BONE = BoneChoice(
    name="solid",
    shape=SPHERE,
    translate=(0.08, 0.04, 0.06),
    rotate=Rotate(axis=(0.3, 1, 0), through=CENTRE, angle=0.35),
)
PART = Rigid(
    name="solid",
    shape=SPHERE,
    about=CENTRE,
    force=(0.05, 0.02, 0.03),
    torque=(0, 0.01, 0.005),
)
#: P2P0 on tetrahedra of a size of 0.06 whose faces are those of the sphere, which is a group.
EXACT = {"solid.rotation.y": 0.2546, "top.x": 0.1993}


def cube(cells, nu=0.45, element="Q1P0", **keys):
    """Return a cube on a clamped bottom."""
    given = {
        "mesh": Geometry(source="cube"),
        "cells": cells,
        "element": element,
        "steps": 2,
        "material": MaterialChoice(name="stable_neo_hookean", E=1.0, nu=nu),
        "hold": [Hold(group="bottom")],
        "reactions": ["bottom"],
        "probe": [Probe(name="top", point=(0.5, 0.5, 1)), Probe(name="side", point=(1, 0.5, 0.5))],
        "error": True,
    }
    return Scene(name="cube", **given | keys)


def pulled(wall, element="Q1", nu=0.3, **keys):
    """Return a cube that is stretched along z between rollers, from a wall at z = ``wall`` on."""
    sides = (("left", "x"), ("right", "x"), ("front", "y"), ("back", "y"))
    fixed = {"about": (0, 0, 0), "translate": (0, 0, 0)}
    below = {"plane": {"point": (0, 0, wall), "normal": (0, 0, 1)}}
    return cube(
        2,
        nu,
        element,
        hold=[Hold(group=group, components=(axis,)) for group, axis in sides],
        move=[Move(group="top", translate=(0, 0, 0.2), components=("z",))],
        rigid=[Rigid(name="wall", shape=below, **fixed)],
        reactions=["top"],
        probe=[Probe(name="middle", point=(0.5, 0.5, 0.5))],
        **keys,
    )


@mpi
@pytest.mark.parametrize("element", ["Q1", "P1", "P2"])
def test_flesh_that_is_strained_alike_is_corrected_to_the_surface(element, comm):
    """The wall ends between nodes, at 0.1: the flesh has the stretch 1 + 0.2 / 0.9 exactly."""
    result = solve(pulled(0.1, element), comm)
    stretch = 1 + 0.2 / 0.9
    P = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.3).pk1(np.diag([1, 1, stretch]))
    for name, exact in (("top.force.z", P[2, 2]), ("middle.z", 0.4 * (stretch - 1))):
        goal = result.goals[name]
        assert abs(goal["value"] - exact) > 0.05 * abs(exact)
        assert goal["corrected"] == pytest.approx(exact, rel=0.005)
        assert abs(goal["parts"]["mesh"]) < 1e-5 < abs(goal["parts"]["shape"])


def test_a_shape_whose_surface_has_the_nodes_is_a_group():
    turn = {"translate": (0.1, 0, 0.1), "rotate": Rotate(axis=(0, 0, 1), angle=0.3)}
    above = {"plane": {"point": (0, 0, 1), "normal": (0, 0, -1)}}
    scenes = [
        cube(3, rigid=[Rigid(name="lid", about=(0.5, 0.5, 1), **kind, **turn)])
        for kind in ({"group": "top"}, {"shape": above})
    ]
    group, shape = (solve(scene).goals for scene in scenes)
    assert "energy" in group and "energy" not in shape
    for name in ("side.x", "side.y", "side.z", "bottom.force.x", "bottom.force.z"):
        assert shape[name]["error"] == pytest.approx(group[name]["error"], rel=1e-6)
        assert "parts" not in shape[name]


@pytest.mark.parametrize("solid", [{"bone": [BONE]}, {"rigid": [PART]}], ids=["bone", "rigid"])
def test_a_finer_mesh_confirms_the_corrected_value(solid):
    coarse, fine = (solve(cube(cells, **solid)) for cells in (6, 11))
    found = 0
    for name, goal in coarse.goals.items():
        estimate = coarse.estimate.goals[name]
        exact = fine.goals[name]["corrected"]
        error = exact - goal["value"]
        if not estimate.is_found or abs(error) < 0.02 * estimate.scale:
            continue
        found += 1
        # Cells that are half as large have the error half and half by chance, but less of it.
        assert abs(fine.goals[name]["value"] - exact) < abs(error), name
        assert 0.7 < goal["error"] / error < 1.4, name
    assert found >= 5


@pytest.mark.one_debian
def test_levels_reach_the_accuracy():
    wanted = Accuracy(goals=["solid.rotation.y", "top.x"], within="10%")
    accuracy = solve(cube(6, rigid=[PART], error=False, accuracy=wanted)).record["accuracy"]
    assert accuracy["reached"]
    for name, goal in accuracy["levels"][-1]["goals"].items():
        assert goal["best"] == pytest.approx(EXACT[name], rel=0.1), name


@mpi
def test_a_point_in_a_bone_moves_with_it(comm):
    inside = Probe(name="inside", point=(0.6, 0.5, 0.6))
    result = solve(cube(4, bone=[BONE], probe=[inside]), comm)
    (placed,) = result.problem.dirichlet.bones
    u = placed.displacement(np.array([inside.point]), 1.0)[0]
    for axis, value in zip("xyz", u, strict=True):
        assert result.goals[f"inside.{axis}"]["corrected"] == pytest.approx(value, abs=1e-12)


@mpi
@pytest.mark.parametrize(
    ("keys", "message"),
    [
        ({"bone": [BONE], "nu": 0.4999}, "in flesh with nu = 0.4999, above 0.495"),
        (
            {"bone": [BoneChoice(name="b", shape={"box": {"center": CENTRE, "size": (0.4,) * 3}})]},
            "the bone 'b' is a shape with edges",
        ),
    ],
)
def test_there_is_no_estimate(comm, keys, message):
    estimate = solve(cube(4, **keys), comm).estimate
    assert message in estimate.reason
    assert "needs a 'group' of the mesh" in estimate.reason
    assert estimate.on_no_mesh


@pytest.mark.parametrize(
    ("shape", "edges"),
    [
        (Sphere((0, 0, 0), 1.0), False),
        (Capsule((0, 0, 0), (1, 0, 0), 0.3), False),
        (Box(), True),
        (Cylinder((0, 0, 0), (1, 0, 0), 0.3), True),
    ],
)
def test_edges(shape, edges):
    assert has_edges(shape) == edges
    assert has_edges(Union((Sphere(), shape))) == edges
    points, triangles = surface_triangles(shape, np.zeros(3), 10.0)
    welded, of_point = np.unique(points.round(9), axis=0, return_inverse=True)
    triangles = of_point[triangles]
    proper = [len(set(corners)) == 3 for corners in triangles]
    assert has_edges(ClosedSurface(welded, triangles[proper])) == edges
