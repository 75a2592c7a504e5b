"""Errors in programs in time: the motion is followed again, as in a scene."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import vector_space
from running import solve
from time_scenes import DOWN, SOFT, in_time

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.boundary_conditions import group_nodes
from fem_snh.mesh import mesh
from fem_snh.scenes import Accuracy, Move, Probe, Reaction, Start

mpi = pytest.mark.mpi
MATERIAL = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.4)
TIGHT = {"snes_scaled_tol": 1e-10}
TIP, SHIFT = (1.0, 1.0, 1.0), (0.0, 0.2, 0.1)
DURATION = 0.4


class Swing:
    """A cube that falls while its left side moves: the displacement of that side, and a program."""

    def __init__(self, comm, **arguments):
        body = mesh.generate(comm, "cube", "hexahedron", cells=2)
        V = vector_space(body.domain)
        nodes, self.side = group_nodes(V, body, "left"), fem.Function(V)
        self.bcs = [_dolfinx.prescribed(self.side, nodes)]
        gravity = fem_snh.Gravity(vector=DOWN.vector)
        self.problem = fem_snh.DynamicProblem(
            fem.Function(V), {MATERIAL: ufl.dx}, {MATERIAL: SOFT.density}, duration=DURATION,
            set_time=self.set_time, bcs=self.bcs, terms=[gravity], petsc_options=TIGHT, **arguments
        )  # fmt: skip

    def set_time(self, t):
        self.side.x.array[:] = np.tile(SHIFT, len(self.side.x.array) // 3) * t / DURATION


@mpi
def test_a_program_in_time_has_the_errors_of_its_scene(comm):
    """From a stretched state that spins, with damping, a moving side and a reaction there."""
    turn, stretch = np.array([0, 0, 3.0]), np.diag([1.1, 1.0, 1.0])
    start = Start(map=stretch.tolist(), velocity=(0.5, 0, 0), angular_velocity=turn.tolist(),
                  through=(0, 0, 0))  # fmt: skip
    scene = in_time(
        {"duration": DURATION, "steps": 4, "damping": {"stiffness": 0.01}},
        move=[Move(group="left", translate=SHIFT)],
        gravity=DOWN,
        start=start,
        probe=[Probe(name="tip", point=TIP)],
        reactions=[Reaction("left")],
        accuracy=Accuracy(goals=["tip", "left.force", "volume"]),
    )
    expected = solve(scene, comm=comm).estimate
    swing = Swing(comm, damping=(0.0, 0.01))
    problem = swing.problem
    problem.u.interpolate(lambda X: (stretch - np.eye(3)) @ X)
    problem.start(lambda X: start.velocity + np.cross(turn, X @ stretch.T))
    list(problem.steps(4))
    functions = problem.u, problem.v, problem.a, swing.side
    before = [f.x.array.copy() for f in functions]
    found = problem.estimate_error({"tip": TIP, "left.force": swing.bcs[0], "volume": "volume"})
    assert (found.reason, found.element) == ("", "Q2Q1")
    for kept, f in zip(before, functions, strict=True):
        np.testing.assert_array_equal(kept, f.x.array)
    assert found.goals.keys() == expected.goals.keys()
    for name, goal in found.goals.items():
        other = expected.goals[name]
        assert goal.parts.keys() == {"time steps", "mesh"}
        assert goal.value == pytest.approx(other.value, abs=1e-8 * other.scale), name
        assert goal.parts == pytest.approx(other.parts, abs=1e-8 * other.scale), name
        assert goal.missed == pytest.approx(other.missed, abs=1e-8 * other.scale), name
