"""Rigid parts in two dimensions: sleeves that torques turn, joints, a pendulum, refusals."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import vector_space
from plane_programs import COMPONENTS, rectangle, sides

import fem_snh

mpi = pytest.mark.mpi

TIGHT = {"snes_scaled_tol": 1e-12}
DENSITY, WIDTH, HEIGHT = 1000.0, 1.0, 0.4


def section(comm, kinematics, parts, low=0.5, **keys):
    """Return a rectangle with a fixed bottom and rigid parts, dx(2) and dx(3), above."""
    domain = rectangle(comm, "Q1", (low, 0), (low + 1, 1), (4, 4))
    V = vector_space(domain, 1, COMPONENTS[kinematics])
    u, index = fem.Function(V), domain.topology.index_map(2)
    tags = np.ones(index.size_local + index.num_ghosts, np.int32)
    for tag, first, last in ((2, -0.1, 0.26), (3, 0.74, 1.1)):
        tags[
            mesh.locate_entities(
                domain,
                2,
                lambda x, a=low + first, b=low + last: (x[0] > a) & (x[0] < b) & (x[1] > 0.49),
            )
        ] = tag
    tagged = mesh.meshtags(domain, 2, np.arange(len(tags), dtype=np.int32), tags)
    dx = ufl.Measure("dx", domain=domain, subdomain_data=tagged)
    fixed = fem.dirichletbc(np.zeros(COMPONENTS[kinematics]), sides(V, 1, 0.0), V)
    m = fem_snh.material("stable_neo_hookean", E=1e4, nu=0.4)
    terms = [fem_snh.Rigid(group=dx(tag), **part) for tag, part in parts.items()]
    keys |= {"kinematics": kinematics, "petsc_options": TIGHT}
    return fem_snh.NonlinearProblem(u, {m: dx}, bcs=[fixed], terms=terms, **keys)


SPRING = {"stiffness": 30.0, "rotation": 3.0}
PARTS = {
    "plane_strain": {
        2: {"spring": SPRING},
        3: {
            "joint": {"kind": "hinge", "axis": (0, 0, 1), "through": (1.2, 0.8, 0), "to": "dx(2)"},
            "spring": {"rotation": 5.0},
        },
    },
    "axisymmetric": {2: {"spring": {"stiffness": 30.0}}, 3: {"force": (0, 20.0, 0)}},
    "axisymmetric_torsion": {
        2: {"spring": SPRING},
        3: {
            "joint": {"kind": "slider", "axis": (0, 1, 0), "through": (0, 0.8, 0), "to": "dx(2)"},
            "spring": {"stiffness": 7.0},
        },
    },
}


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("kinematics", PARTS)
def test_residual_and_hessian_are_derivatives_along_the_motion(comm, kinematics):
    # The axis of revolution is in a part: its conditions are the part's own.
    low = 0.0 if kinematics == "axisymmetric_torsion" else 0.5
    problem = section(comm, kinematics, PARTS[kinematics], low)._problem
    x, end = problem.x, problem.x.duplicate()

    def step(wave, size):
        d, components = x.duplicate(), COMPONENTS[kinematics]
        d.array[:] = np.sin(wave * problem.coordinates + wave)[:, :components].ravel()
        d.array[problem.constrained_dofs] = 0.0
        d.scale(size)
        return d

    problem.retraction(x, step(9.0, 0.05), 1.0, end)
    end.copy(x)
    d, f, Hd = step(5.0, 0.1), x.duplicate(), x.duplicate()

    def energy(s):
        problem.retraction(x, d, s, end)
        return problem.energy(end)

    problem.residual(x, f)
    h = 1e-3
    slope = (8 * (energy(h) - energy(-h)) - energy(2 * h) + energy(-2 * h)) / (12 * h)
    assert f.dot(d) == pytest.approx(slope, rel=1e-7)
    problem.jacobian(x, "exact")
    problem.A.mult(d, Hd)
    h = 1e-2
    inner, outer = energy(h) + energy(-h), energy(2 * h) + energy(-2 * h)
    curvature = (16 * inner - 30 * energy(0.0) - outer) / (12 * h**2)
    assert d.dot(Hd) == pytest.approx(curvature, rel=1e-6)


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
