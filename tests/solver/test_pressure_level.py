"""Incompressible bodies whose whole boundary is prescribed: the pressure has no level."""

from __future__ import annotations

import numpy as np
import pytest
from running import solve

from fem_snh.scenes import Geometry, Gravity, Hold, MaterialChoice, Move, Probe, Rigid, Scene

mpi = pytest.mark.mpi
SIDES = ("left", "right", "front", "back")


def cube(nu, sides=SIDES, **keys):
    """A cube whose top slides, clamped at the other faces of ``sides``."""
    return Scene(
        name="cube",
        mesh=Geometry(source="cube"),
        cells=2,
        element="Q2Q1",
        material=MaterialChoice(name="stable_neo_hookean", E=1.0, nu=nu),
        hold=[Hold(group=group) for group in ("bottom", *sides)],
        **keys,
    )


def kinds(result):
    assert result.converged
    return [note["kind"] for note in result.notes]


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize(
    "nu, sides, noted", [(0.5, SIDES, 1), (0.5, SIDES[1:], 0), (0.49, SIDES, 0)]
)
def test_the_level_is_free_where_all_is_prescribed(comm, nu, sides, noted):
    slide = [Move(group="top", translate=(0.05, 0, 0))]
    assert kinds(solve(cube(nu, sides, move=slide), comm)).count("pressure") == noted


@pytest.mark.parametrize("element", ["Q2Q1", "P2P1"])
def test_sparse_factors_of_the_singular_matrix(element):
    """A bushing between two sleeves: its torque has no part of the pressure, and is as exact."""
    common = {"kinematics": "plane_strain", "radial": 0.0, "cells": 4, "element": element}
    torque = {}
    for nu in (0.49999, 0.5):
        result = solve("bushing", nu=nu, **common)
        assert ("pressure" in kinds(result)) == (nu == 0.5)
        torque[nu] = result.steps[-1]["moments"]["inner"][2]
    assert torque[0.5] == pytest.approx(torque[0.49999], rel=1e-4)


LU = {"ksp_type": "preonly", "pc_type": "lu", "pc_factor_mat_solver_type": "mumps"}
#: Of a bar whose second half has whole cells that nothing deforms: what moves its first half.
HEADS = {
    "rigid": {"hold": [Hold(group="left")], "rigid": [Rigid(group="second", force=(0, 0, -40.0))]},
    "clamped": {"hold": [Hold(group="second")], "gravity": Gravity(vector=(0, 0, -30.0))},
}


def bar(element, cells, **keys):
    mesh = Geometry(source="bar", parameters={"length": 4.0, "interface": 2.0})
    return Scene(name="bar", mesh=mesh, cells=cells, steps=1, element=element, **keys)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize(
    ("head", "element", "petsc"),
    [("rigid", "Q2Q1", {}), ("rigid", "P2P1", LU), ("clamped", "P2P1", {})],
)
def test_pressures_of_cells_that_do_not_deform(comm, head, element, petsc):
    """At nu = 0.5 their rows were zero, and Newton's method met NaN; with factors at any nu."""
    lowest = []
    points = {"end": (2, 0.5, 0.5), "tip": (0, 0.5, 0.5)}
    for nu in (0.4999, 0.5):
        scene = bar(
            element, 1,
            material=MaterialChoice(name="stable_neo_hookean", E=1e4, nu=nu, density=1.0),
            petsc={"snes_scaled_tol": 1e-8} | petsc,
            probe=[Probe(name=name, point=point) for name, point in points.items()],
            **HEADS[head],
        )  # fmt: skip
        result = solve(scene, comm)
        assert result.converged
        lowest.append(min(point[2] for point in result.steps[-1]["probes"].values()))
    assert lowest[0] < -1e-3
    assert lowest[1] == pytest.approx(lowest[0], rel=1e-3)


@mpi
def test_pressures_in_a_rigid_shape_in_two_materials(comm):
    """Their masses are zero: a quotient of zeros was NaN."""
    ends = []
    for nu in (0.4999, 0.5):
        flesh = {"name": "stable_neo_hookean", "nu": nu}
        pair = [MaterialChoice(group=g, E=E, **flesh) for g, E in (("first", 1e4), ("second", 2e4))]
        shape = {"box": {"center": (3.5, 0.5, 0.5), "size": (1.2, 3, 3)}}
        head = Rigid(name="head", shape=shape, force=(0, 0, -40.0))
        scene = bar("Q2Q1", 2, material=pair, hold=[Hold(group="left")], rigid=[head])
        with np.errstate(invalid="raise", divide="raise"):
            result = solve(scene, comm)
        assert result.converged
        ends.append(result.steps[-1]["rigid"]["head"]["position"][2] - 0.5)
    assert ends[1] == pytest.approx(ends[0], rel=1e-3)
