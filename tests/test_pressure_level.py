"""Incompressible bodies whose whole boundary is prescribed: the pressure has no level."""

from __future__ import annotations

import pytest
from running import solve

from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Rigid, Scene

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


@mpi
@pytest.mark.parametrize(
    "nu, sides, noted", [(0.5, SIDES, 1), (0.5, SIDES[1:], 0), (0.49, SIDES, 0)]
)
def test_the_level_is_free_where_all_is_prescribed(comm, nu, sides, noted):
    slide = [Move(group="top", translate=(0.05, 0, 0))]
    assert kinds(solve(cube(nu, sides, move=slide), comm)).count("pressure") == noted


@mpi
def test_a_rigid_part_that_is_free_determines_it(comm):
    """It could rise, against the pressure; one whose motion is given could not."""
    free = Rigid(group="top", force=(0.01, 0, 0))
    given = Rigid(group="top", translate=(0.05, 0, 0))
    assert "pressure" not in kinds(solve(cube(0.5, ("left",), rigid=[free]), comm))
    assert "pressure" in kinds(solve(cube(0.5, rigid=[given]), comm))


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


@mpi
def test_asking_leaves_the_state_as_it_is(comm):
    """The displacement of a program, and the pressure that was evaluated last."""
    problem = solve(cube(0.5, move=[Move(group="top", translate=(0.05, 0, 0))]), comm).problem
    problem.split(problem.x)
    u, p = problem.u.x.array.copy(), problem.saddle_point.pressure().copy()
    del problem.pressure_level_is_free  # it is kept
    assert problem.pressure_level_is_free
    assert (problem.u.x.array == u).all() and (problem.saddle_point.pressure() == p).all()
