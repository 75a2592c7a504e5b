"""`fem_snh.NonlinearProblem`: a solve in a user's dolfinx program."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from bodies import PRESS
from dolfinx import fem
from dolfinx_programs import Bar, Press, converged, halves, unit_cube

import fem_snh
from fem_snh.runs.setup import set_up

pytestmark = pytest.mark.mpi

SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)
TIGHT = {"snes_scaled_tol": 1e-11}


def difference(comm, a, b):
    """The largest difference of two functions, over the largest value. Collective."""
    largest = max(comm.allgather(abs(b).max(initial=0)))
    return max(comm.allgather(abs(a - b).max(initial=0))) / largest


def test_agrees_with_a_scene(comm):
    material = PRESS.material.model_copy(update={"name": "stable_neo_hookean", "nu": 0.49})
    scene = PRESS.model_copy(update={"material": material, "predictor": "extrapolate"})
    setup = set_up(comm, scene)
    row = next(iter(setup.stepper))
    assert row["converged"]
    body = Press(setup.problem.domain, height=-0.5)
    problem = fem_snh.NonlinearProblem(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    assert problem.solve() is body.u and converged(problem)
    assert difference(comm, body.u.x.array, setup.problem.u.x.array) < 1e-12
    assert len(problem.solver.getPythonContext().history) + 1 == row["newton"]


def test_materials_by_meshtags(comm):
    domain = unit_cube(comm)
    dx = ufl.Measure("dx", domain, subdomain_data=halves(domain))
    stiff = fem_snh.material("stable_neo_hookean", E=10.0, nu=0.49)
    found = []
    for materials in (
        {SNH: dx},
        {SNH: dx(1), fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49): dx(2)},
        {SNH: dx((1, 2))},
        {SNH: dx(1), stiff: dx(2)},
    ):
        body = Press(domain)
        problem = fem_snh.NonlinearProblem(body.u, materials, bcs=body.bcs, petsc_options=TIGHT)
        problem.solve()
        assert converged(problem)
        found.append(body.u.x.array)
    assert difference(comm, found[1], found[0]) < 1e-11
    assert difference(comm, found[2], found[0]) < 1e-15
    assert difference(comm, found[3], found[0]) > 1e-2


@pytest.mark.parametrize("hessian", ["clamp", "abs", None])
def test_ufl_energy_in_place_of_a_material(comm, hessian):
    """A problem without materials, whose start is far from its solution."""
    domain = unit_cube(comm, 2)
    body, other = Press(domain, height=-0.6), Press(domain, height=-0.6)
    dx = ufl.dx(metadata={"quadrature_degree": 3})
    options = {"petsc_options": TIGHT, "hessian": hessian}
    by_kernels = fem_snh.NonlinearProblem(other.u, {SNH: dx}, bcs=other.bcs, **options)
    by_kernels.solve()
    energy = SNH.ufl(body.F) * dx
    problem = fem_snh.NonlinearProblem(body.u, {}, bcs=body.bcs, terms=[energy], **options)
    problem.solve()
    assert converged(problem) and converged(by_kernels)
    assert difference(comm, body.u.x.array, other.u.x.array) < 1e-9
    filters = {iteration.filter for iteration in problem.solver.getPythonContext().history}
    assert filters <= {"exact", "none needed", hessian or "clamp"}


def test_values_change_between_solves(comm):
    """A time loop: a component's boundary value and a load change; uniaxial stretch is exact."""
    bar = Bar(unit_cube(comm, 2))
    ds = ufl.Measure("ds", bar.domain)
    pressure = fem.Constant(bar.domain, 0.0)
    loads = (
        pressure
        * bar.u[1]
        * ufl.conditional(ufl.gt(ufl.SpatialCoordinate(bar.domain)[1], 0.99), 1, 0)
        * ds
    )
    problem = fem_snh.NonlinearProblem(
        bar.u, {SNH: ufl.dx}, bcs=bar.bcs, terms=[loads], petsc_options=TIGHT
    )
    lateral = []
    for pull, load in ((0.2, 0.0), (0.6, 0.0), (0.6, 0.05), (0.6, 0.0)):
        bar.pull.value, pressure.value = pull, load
        problem.solve()
        assert converged(problem)
        y = bar.u.x.array[1::3]
        lateral.append(min(comm.allgather(y.min(initial=0))))
        if not load:
            assert stretched_width(1 + pull) - 1 == pytest.approx(lateral[-1], abs=1e-9)
    assert lateral[2] < lateral[3] - 1e-3
    history = problem.solver.getPythonContext().history
    problem.solve()  # nothing has changed
    assert history and not problem.solver.getPythonContext().history


def stretched_width(s):
    """Width of a bar stretched by s, whose sides are free: the root of the lateral stress."""

    def stress(w):
        return SNH.pk1(np.diag([s, w, w]))[1, 1]

    from scipy.optimize import brentq

    return brentq(stress, 0.3, 1.5, xtol=1e-13)


def test_unknown_pressure(comm):
    """Taylor-Hood elements at nu = 1/2: the bar keeps its volume, and its pressure is uniform."""
    bar = Bar(unit_cube(comm, 2, "tetrahedron"), degree=2, pull=0.5)
    rubber = fem_snh.material("neo_hookean", E=3.0, nu=0.5)
    problem = fem_snh.NonlinearProblem(
        bar.u,
        {rubber: ufl.dx},
        bcs=bar.bcs,
        element="P2P1",
        petsc_options={"snes_scaled_tol": 1e-9},
    )
    problem.solve()
    assert converged(problem)
    y = bar.u.x.array[1::3]
    assert min(comm.allgather(y.min(initial=0))) == pytest.approx(1.5**-0.5 - 1, abs=1e-7)
    mean = problem.p.x.array.mean()
    assert abs(mean) > 0.1 and abs(problem.p.x.array - mean).max() < 1e-6


def test_solver_that_diverges(comm):
    body = Press(unit_cube(comm, 2))
    options = {"snes_max_it": 1, "snes_hessian": "clamp"}
    problem = fem_snh.NonlinearProblem(
        body.u, {SNH: ufl.dx}, bcs=body.bcs, petsc_options=options, predictor="none"
    )
    problem.solve()
    assert problem.solver.getConvergedReason() == PETSc.SNES.ConvergedReason.DIVERGED_MAX_IT
    assert problem.b.norm() > 0 and problem.A.getSize() == (81, 81) and problem.x.getSize() == 81
    options["snes_error_if_not_converged"] = None
    problem = fem_snh.NonlinearProblem(
        body.u, {SNH: ufl.dx}, bcs=body.bcs, petsc_options=options, petsc_options_prefix="other_"
    )
    body.u.x.array[:] = 0
    with pytest.raises(PETSc.Error):
        problem.solve()
    assert not PETSc.Options("other_").hasName("snes_max_it")
