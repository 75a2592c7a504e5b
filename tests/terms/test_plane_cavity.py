"""Cavities of two dimensions: an inflated tube in its cross-section, and a spherical shell."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest
import ufl
from gmsh_files import section
from plane_scenes import TIGHT, solve

import fem_snh
from fem_snh import scenes
from fem_snh.errors import BadInput

INNER, OUTER = 1.0, 1.5


def ring(path):
    """A quarter of a ring, with the groups x0, y0 (its cuts), inner and outer."""
    with section(path, 2) as (geo, curves, surfaces):
        corners = [(0, 0), (INNER, 0), (OUTER, 0), (0, OUTER), (0, INNER)]
        for number, (x, y) in enumerate(corners, 1):
            geo.addPoint(x, y, 0, 1.0, number)
        geo.addLine(2, 3, 1)
        geo.addCircleArc(3, 1, 4, 2)
        geo.addLine(4, 5, 3)
        geo.addCircleArc(5, 1, 2, 4)
        surface = geo.addPlaneSurface([geo.addCurveLoop([1, 2, 3, 4])])
        for line, points in ((1, 4), (3, 4), (2, 7), (4, 7)):
            geo.mesh.setTransfiniteCurve(line, points)
        geo.mesh.setTransfiniteSurface(surface)
        geo.mesh.setRecombine(2, surface)
        curves |= {"y0": [1], "outer": [2], "x0": [3], "inner": [4]}
        surfaces["body"] = [surface]


SHELL = """
mesh = "ring.msh"
element = "Q2"
kinematics = "{kinematics}"
steps = 4
material = {{ name = "stable_neo_hookean", E = 3.0, nu = {nu} }}
hold = [{{ group = "y0", components = ["y"] }}, {{ group = "x0", components = ["x"] }}]
cavity = [{{ group = "inner", volume = {volume!r} }}]
probe = [{{ name = "equator", point = [1, 0, 0] }}]
"""


def scene(comm, folder, **values):
    """Return the file of a scene, whose mesh is beside it. Collective."""
    if comm.rank == 0:
        ring(folder / "ring.msh")
        (folder / "shell.toml").write_text(SHELL.format(**values))
    comm.barrier()
    return folder / "shell.toml"


def pressure(kinematics, a):
    """Of an incompressible neo-Hookean wall, mu = 1, whose inside is stretched by a, by quadrature.

    A tube: dp = (l^2 - l^-2) dr/r (Ogden 1997, section 5.3.3). A shell: with the hoop stretch l,
    the integral of (2 l - 2 l^-5)/(l^3 - 1) from b to a.
    """
    if kinematics == "plane_strain":
        r = np.linspace(a, np.sqrt(OUTER**2 + a**2 - 1), 20001)
        hoop = r / np.sqrt(r**2 - a**2 + 1)
        f = (hoop**2 - hoop**-2.0) / r
    else:
        b = (1 + (a**3 - 1) / OUTER**3) ** (1 / 3)
        r = np.linspace(b, a, 20001)
        f = (2 * r - 2 * r**-5.0) / (r**3 - 1)
    return float(((f[1:] + f[:-1]) / 2 * np.diff(r)).sum())


@pytest.mark.mpi
@pytest.mark.parametrize("kinematics", ["plane_strain", "axisymmetric"])
def test_inflation_by_a_volume(comm, folder, kinematics):
    """Pressure and radius of the exact solution; the shell is past its limit point."""
    stretch = 1.6
    share = pi / 4 * (stretch**2 - 1) if kinematics == "plane_strain" else 0.0
    share = share or 2 / 3 * pi * (stretch**3 - 1)  # half of the ball
    result = solve(scene(comm, folder, kinematics=kinematics, nu=0.49, volume=share), comm)
    assert result.record["linear_solver"] == "preonly+cholesky"
    for row in result.steps:
        state = row["cavities"]["inner"]
        a = 1 + row["probes"]["equator"][0]
        assert state["pressure"] == pytest.approx(pressure(kinematics, a), rel=0.02)
    assert a == pytest.approx(stretch, rel=5e-3)
    assert state["volume"] == pytest.approx(share, rel=0.02)


@pytest.mark.mpi
def test_factors_of_the_sum(comm, folder):
    """Sparse factors are those of the Hessian with the fluid's part of rank one."""
    path, rows = scene(comm, folder, kinematics="axisymmetric", nu=0.3, volume=14 / 3 * pi), []
    for petsc in ({}, {"snes_linear_solver": "direct"}):
        result = solve(path, comm, petsc=petsc | TIGHT)
        rows.append(result.steps[-1]["cavities"]["inner"]["pressure"])
    assert result.record["linear_solver"] == "preonly+cholesky"
    assert rows[1] == pytest.approx(rows[0], rel=1e-9)
    with pytest.raises(BadInput, match="ksp_type = preonly: expected an iterative solver"):
        solve(path, comm, petsc={"ksp_type": "preonly", "pc_type": "lu"})


@pytest.mark.one_debian
@pytest.mark.mpi
def test_factors_of_a_sum_that_is_not_symmetric(comm, folder):
    """A residual without an energy, beside the fluid's part of rank one."""
    path = scene(comm, folder, kinematics="plane_strain", nu=0.4, volume=0.8)
    arguments = dict(scenes.load(str(path)).build(comm).arguments)
    u = arguments["u"]
    v = ufl.TestFunction(u.function_space)
    arguments["terms"] = [*arguments["terms"], 3.0 * (u[0] * v[1] - u[1] * v[0]) * ufl.dx]
    program = fem_snh.NonlinearProblem(**arguments)
    problem, solver = program._problem, program.solver.getPythonContext().asymmetric
    problem.set_load(1.0)
    problem.jacobian(problem.x, "exact", whole=True)
    assert solver.needed and problem.operator != problem.A
    b, x, residual = (problem.x.duplicate() for _ in range(3))
    b.set(1.0)
    b.array[problem.constrained_dofs] = 0.0
    solver.ksp.setOperators(problem.operator, problem.A)
    solver.ksp.setTolerances(rtol=1e-10)
    solver.ksp.solve(b, x)
    problem.operator.mult(x, residual)
    residual.axpy(-1.0, b)
    assert residual.norm() <= 1e-8 * b.norm()
