"""Predictors, and the invariance of a solve under scale and rotation."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import MINIMISING, Condition, cube, norm, problem, set_values
from solver_problems import options, solve, turned, twist

from fem_snh import Traction, solver
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.choices import PREDICTORS

mpi = pytest.mark.mpi
elements = pytest.mark.parametrize("element", MINIMISING)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_predictors_reach_the_same_state(comm, element):
    energies, iterations = {}, {}
    for kind in sorted(set(PREDICTORS) - {"bones"}):  # tests/problem/test_bones.py
        p = twist(comm, element, cells=2, angle=0.6)
        with options(snes_scaled_tol=1e-9):
            snes = solver.create(p)
        predictor, iterations[kind] = solver.Predictor(p, snes, kind), 0
        for load in (0.25, 0.5, 0.75, 1.0):
            assert (predictor.predict(load) > 0) == (
                kind == "tangent" or (kind == "extrapolate" and load == 0.25)
            )
            snes.solve(None, p.x)
            assert snes.getConvergedReason() > 0
            predictor.accept()
            iterations[kind] += snes.getIterationNumber()
        energies[kind] = p.energy(p.x)
    assert energies["extrapolate"] == pytest.approx(energies["none"], rel=1e-9)
    assert energies["tangent"] == pytest.approx(energies["none"], rel=1e-9)
    assert max(iterations["tangent"], iterations["extrapolate"]) < iterations["none"]


@pytest.mark.one_debian
@mpi
@elements
def test_tangent_prediction_is_of_second_order(comm, element):
    """Its error is of second order in the load, with moved boundaries and with tractions."""
    sizes, errors = (0.08, 0.04, 0.02), []
    for load in sizes:
        p = twist(comm, element, cells=2, angle=1.0, features=[Traction("left", (0, 0.1, 0))])
        with options(ksp_rtol=1e-10, snes_scaled_tol=1e-12):
            snes = solver.create(p)
            predictor = solver.Predictor(p, snes, "tangent")
            # `predict` has a relative tolerance of 1e-2; the order needs a smaller one.
            snes.getKSP().setConvergenceTest(
                lambda ksp, its, r, first=[0.0]: (
                    first.__setitem__(0, r if its == 0 else first[0])
                    or (2 if r <= 1e-11 * first[0] else 0)
                )
            )
            predictor.predict(load)
            guess = p.x.copy()
            snes.getPythonContext().options["snes_forcing_max"] = 0
            snes.solve(None, p.x)
        assert snes.getConvergedReason() > 0
        guess.axpy(-1, p.x)
        errors.append(guess.norm())
    assert np.polyfit(np.log(sizes), np.log(errors), 1)[0] == pytest.approx(2, abs=0.3)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_frame_indifference_of_the_whole_solve(comm, element):
    """Rotating all boundary values rotates the solution, iteration by iteration."""
    R = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    R *= np.linalg.det(R)

    def solution(frame):
        top = turned(0.5)
        conditions = [
            Condition("bottom", lambda X, load: X @ (frame.T - np.eye(3))),
            Condition("top", lambda X, load: (X + top(X, load)) @ frame.T - X),
        ]
        p = problem(cube(comm, ELEMENTS[element].cell, 2, 0.05), element, move=conditions)
        set_values(p, lambda X: X @ (frame.T - np.eye(3)))
        with options(snes_scaled_tol=1e-10, ksp_rtol=1e-10, snes_forcing_max=0):
            _, context = solve(p, hessian="clamp")
        X = p.V.tabulate_dof_coordinates()[: p.x.getLocalSize() // 3]
        return p, context, X + p.x.array.reshape(-1, 3)

    p, context, x = solution(np.eye(3))
    q, turned_context, y = solution(R)
    assert len(context.history) == len(turned_context.history) > 2
    assert q.energy(q.x) == pytest.approx(p.energy(p.x), rel=1e-9)
    assert norm(comm, y - x @ R.T) <= 1e-8 * norm(comm, x)
