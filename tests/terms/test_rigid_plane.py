"""Rigid parts in two dimensions: sleeves that torques turn, joints, a pendulum, refusals."""

from __future__ import annotations

import numpy as np
import pytest
from dolfinx import fem
from dolfinx_programs import tagged_measure, vector_space
from plane_programs import COMPONENTS, rectangle, sides
from rigid_bodies import check_derivatives

import fem_snh

mpi = pytest.mark.mpi

TIGHT = {"snes_scaled_tol": 1e-12}


def section(comm, kinematics, parts, low):
    """Return a rectangle with a fixed bottom and rigid parts, dx(2) and dx(3), above."""
    domain = rectangle(comm, "Q1", (low, 0), (low + 1, 1), (4, 4))
    V = vector_space(domain, 1, COMPONENTS[kinematics])
    corners = [lambda x: x[0] < low + 0.26, lambda x: x[0] > low + 0.74]
    places = [lambda x, at=corner: at(x) & (x[1] > 0.49) for corner in corners]
    dx = tagged_measure("dx", domain, [lambda x: x[0] == x[0], *places])
    fixed = fem.dirichletbc(np.zeros(COMPONENTS[kinematics]), sides(V, 1, 0.0), V)
    m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.4)
    terms = [fem_snh.Rigid(group=dx(tag), **part) for tag, part in enumerate(parts, 2)]
    keys = {"kinematics": kinematics, "petsc_options": TIGHT}
    return fem_snh.NonlinearProblem(fem.Function(V), {m: dx}, bcs=[fixed], terms=terms, **keys)


SPRING = {"stiffness": 30.0, "rotation": 3.0}
HINGE = {"kind": "hinge", "axis": (0, 0, 1), "through": (1.2, 0.8, 0), "to": "dx(2)"}
SLIDER = {"kind": "slider", "axis": (0, 1, 0), "through": (0, 0.8, 0), "to": "dx(2)"}
#: The keys of the parts dx(2) and dx(3).
PARTS = {
    "plane_strain": ({"spring": SPRING}, {"joint": HINGE, "spring": {"rotation": 5.0}}),
    "axisymmetric": ({"spring": {"stiffness": 30.0}}, {"force": (0, 20.0, 0)}),
    "axisymmetric_torsion": (
        {"spring": SPRING}, {"joint": SLIDER, "spring": {"stiffness": 7.0}},
    ),
}  # fmt: skip


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("kinematics", PARTS)
def test_residual_and_hessian_are_derivatives_along_the_motion(comm, kinematics):
    # The axis of revolution is in a part: its conditions are the part's own.
    low = 0.0 if kinematics == "axisymmetric_torsion" else 0.5
    check_derivatives(section(comm, kinematics, PARTS[kinematics], low)._problem)


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric_torsion"])
def test_torque_on_the_inner_sleeve_of_a_bushing_is_inverse_to_its_rotation(comm, kinematics):
    flat = kinematics == "plane_strain"
    keys = {"kinematics": kinematics, "cells": 2, "nu": 0.49, "petsc": TIGHT, "comm": comm}
    turned = fem_snh.run("bushing", angle=0.5, progress=False, **keys)
    torque = turned.steps[-1]["moments"]["inner"][2 if flat else 1]
    loaded = fem_snh.run("bushing", torque=torque, progress=False, **keys)
    assert turned.converged and loaded.converged
    state, angle = loaded.steps[-1]["rigid"]["inner"], 0.5 * np.array([0, not flat, flat])
    assert state["rotation"] == pytest.approx(angle, abs=1e-8)
    # The radial part of a reaction is no resultant: a rigid part has none.
    reaction = np.where([flat, True, False], turned.steps[-1]["reactions"]["inner"], 0.0)
    assert state["force"] == pytest.approx(reaction, abs=1e-4)
