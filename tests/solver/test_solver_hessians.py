"""Newton's method with each Hessian: same states, histories, rates of convergence."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from bodies import MINIMISING, norm
from solver_problems import options, solve, twist

from fem_snh import solver
from fem_snh.choices import GLOBALIZATIONS, HESSIANS
from fem_snh.runs import run

mpi = pytest.mark.mpi
elements = pytest.mark.parametrize("element", MINIMISING)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("hessian", HESSIANS)
@pytest.mark.parametrize("globalization", GLOBALIZATIONS)
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_every_choice_reaches_the_same_state(comm, element, hessian, globalization):
    p, reference = (twist(comm, element, cells=2, angle=0.3) for _ in range(2))
    with options(snes_scaled_tol=1e-9):
        snes, context = solve(p, "tangent", hessian, globalization)
        solve(reference, hessian="clamp", predictor="tangent")
    assert solver.converged_reason(snes) == "CONVERGED_FNORM_ABS"
    assert p.energy(p.x) == pytest.approx(reference.energy(reference.x), rel=1e-9)
    assert norm(comm, p.x.array - reference.x.array) <= 1e-6 * p.x.norm()
    used = {i.filter for i in context.history}
    wanted = {"exact": {"exact", "none needed"}, "adaptive": {"exact", "none needed", "clamp"}}
    assert used <= wanted.get(hessian, {hessian})


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("globalization", GLOBALIZATIONS)
@pytest.mark.parametrize("hessian", ["clamp", "abs", "adaptive"])  # exact may fail
@pytest.mark.parametrize("name", ["stable_neo_hookean", "neo_hookean", "fixed_corotational"])
def test_energy_and_history_of_a_strong_twist(comm, name, hessian, globalization):
    """From a distant start the energy decreases in every iteration; the history is complete."""
    p = twist(comm, name=name, cells=3, angle=0.8)
    snes, context = solve(p, hessian=hessian, globalization=globalization)
    assert snes.getConvergedReason() > 0
    history = context.history
    assert len(history) == snes.getIterationNumber() > 2
    energies = [i.energy for i in history] + [p.energy(p.x)]
    assert (np.diff(energies) <= 1e-12 * abs(np.array(energies[1:]))).all()
    assert all(0 < i.step <= 3 and i.linear > 0 for i in history)
    assert all(
        (i.filtered_points > 0) == (i.filter != "none needed") or hessian in ("clamp", "abs")
        for i in history
    )
    r = p.x.duplicate()
    p.residual(p.x, r)
    assert r.norm() == pytest.approx(snes.getFunctionNorm(), rel=1e-9)
    assert r.norm() <= 1e-7 * p.force_scale


@pytest.mark.one_debian("ranks")
@mpi
def test_adaptive_filters_only_where_the_solver_meets_negative_curvature(comm):
    """It falls back far from the solution, and keeps the exact Hessian near a stable one, even
    with negative eigenvalues at some points."""
    p = twist(comm, angle=1.2)
    _, far = solve(p)
    assert {"clamp"} < {i.filter for i in far.history}
    assert far.history[-1].filter == "exact" and far.history[-1].filtered_points > 0
    near = solver.create(p)
    p.set_load(1.01)
    p.prescribe(p.x)
    near.solve(None, p.x)
    assert {i.filter for i in near.getPythonContext().history} <= {"exact", "none needed"}


@pytest.mark.one_debian
@mpi
@elements
def test_exact_newton_converges_quadratically(comm, element):
    p = twist(comm, element, cells=2, angle=0.1)
    with options(ksp_rtol=1e-12, snes_forcing_max=0, snes_scaled_tol=1e-13):
        snes, context = solve(p, hessian="exact")
    norms = [*(i.residual for i in context.history), snes.getFunctionNorm()]
    rates = [b / a**2 for a, b in pairwise(norms) if a < 1e-3 and b > 1e-13]
    assert norms[-1] <= 1e-13 and len(norms) <= 7
    assert rates and max(rates) <= 100


@pytest.mark.one_debian
@pytest.mark.parametrize("seed", [43, 98])
def test_double_precision_replaces_failing_single_precision(seed):
    """In one scramble SSOR overflows; in the other rounding makes the clamped matrix indefinite."""
    case = {"cells": 10, "element": "P1", "nu": 0.45, "seed": seed, "nu_continuation": [-0.3]}
    result = run("scramble", **case, progress=False)
    assert result.converged and result.steps[-1]["max_u"] < 1e-6
