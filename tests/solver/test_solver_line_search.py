"""The line search, of functions of one unknown and of real problems."""

from __future__ import annotations

from dataclasses import dataclass
from types import SimpleNamespace

from petsc4py import PETSc

import pytest
from bodies import Hold, cube, problem
from solver_problems import options, solve, twist

from fem_snh import Traction, solver
from fem_snh.runs import run
from fem_snh.solver.step import LineSearch, State

mpi = pytest.mark.mpi


@dataclass
class Scalar:
    """An energy of one unknown, with the callbacks of a SNES."""

    energy: object
    slope: object
    calls: int = 0

    def computeObjective(self, x):
        self.calls += 1
        return self.energy(x.array[0])

    def computeFunction(self, x, f):
        f.array[0] = self.slope(x.array[0])


def search(energy, slope, x, d, scale=0.0, **paths):
    """Return step and energy (None without), trial point, residual there, energy evaluations."""
    vectors = [PETSc.Vec().createSeq(1, comm=PETSc.COMM_SELF) for _ in range(5)]
    at, residual, along, trial, f_trial = vectors
    at.set(x)
    along.set(d)
    snes, end = Scalar(energy, slope), State(trial, f_trial)
    admitted = {"largest_step": None, "retraction": None, "step_end": None} | paths
    problem = SimpleNamespace(has_energy=True, force_scale=scale, length=1.0, **admitted)
    line = LineSearch(snes, problem)
    step = line.search(State(at, residual, energy(x)), along, slope(x) * d, end)
    found = step.end and (step.length, step.end.energy)
    return found, trial.array[0], f_trial.array[0], snes.calls


def test_backtracks_to_the_minimum_of_the_parabola():
    found, at, _, calls = search(lambda x: x**2, lambda x: 2 * x, 1.0, -4.0)
    assert found == pytest.approx((0.25, 0.0), abs=1e-15) and at == pytest.approx(0) and calls == 2


@pytest.mark.parametrize(("wall", "reached"), [(-0.3, -0.25), (-0.2, 0.0)])
def test_a_curved_path_ends_where_the_step_is_admissible(wall, reached):
    """Behind a wall on the way to its end, as for a barrier of contact, the step is straight."""

    def curve(x, d, step, end):
        end.set(x.array_r[0] + 1.25 * step * d.array_r[0])

    curve.exact = False

    def to_the_wall(x, d):
        return 1.0 if x.array_r[0] + d.array_r[0] >= wall else 0.5

    paths = {"retraction": curve, "largest_step": to_the_wall}
    found, at, _, _ = search(lambda x: x**2, lambda x: 2 * x, 1.0, -1.0, **paths)
    assert found == (1.0, reached**2) and at == reached


def test_full_step_is_extended_where_the_energy_still_decreases():
    """A Hessian that is 2.5 times too stiff: the secant of the slope finds the minimum."""
    (step, there), at, f, _ = search(lambda x: x**2, lambda x: 2 * x, 1.0, -0.4)
    assert step == pytest.approx(2.5) and at == pytest.approx(0) and f == pytest.approx(0)
    assert there == pytest.approx(0)


def test_slopes_decide_where_the_energy_is_constant_in_floating_point():
    """1e6 + x^2 is constant in floating point for |x| < 1e-6; its slope is not."""
    (step, _), at, f, _ = search(lambda x: 1e6 + x**2, lambda x: 2 * x, 1e-6, -1e-6)
    assert step == 1.0 and abs(f) < 1e-12 and at == 0
    # A step as far to the other side is rejected, though the energy would accept it.
    (step, _), at, _, _ = search(lambda x: 1e6 + x**2, lambda x: 2 * x, 1e-6, -4e-6)
    assert step < 1.0 and abs(at) < 1e-6


def test_no_step_without_descent():
    """A slope of the wrong sign: the energy increases along the direction."""
    found, *_ = search(lambda x: -x, lambda x: 1.0, 1.0, -1.0)
    assert found is None


@pytest.mark.one_debian("ranks")
@mpi
def test_steps_out_of_the_domain_are_backtracked(comm):
    """Full Newton steps under this traction overshoot; neo_hookean requires J > 0."""
    body = cube(comm, "hexahedron", 2)
    p = problem(
        body, "Q1", "neo_hookean", hold=[Hold("left")], features=[Traction("right", (-0.8, 0, 0))]
    )
    snes, context = solve(p, hessian="clamp")
    assert snes.getConvergedReason() > 0
    assert p.measures(p.x)["min_J"] > 0
    assert min(i.step for i in context.history) < 1


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("hessian", ["exact", "adaptive", "clamp"])
@pytest.mark.parametrize("angle", [1e-5, 0.3])
def test_tight_tolerances_are_reached_where_energies_no_longer_change(comm, hessian, angle):
    """1e-12 E V^(2/3): the energy is constant in floating point long before."""
    p = twist(comm, cells=2, angle=angle)
    with options(snes_scaled_tol=1e-13 if angle < 0.1 else 1e-12, ksp_rtol=1e-6):
        snes, context = solve(p, hessian=hessian, predictor="tangent")
    assert solver.converged_reason(snes) == "CONVERGED_FNORM_ABS"
    assert all(i.step > 1e-3 for i in context.history)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("hessian", ["clamp", "adaptive"])
def test_line_search_is_on_the_residual_without_an_energy(hessian):
    """The filtered stress equals the plain one while no stretch is below the threshold."""
    states = []
    for name in ("filtered_neo_hookean", "neo_hookean"):
        result = run(
            "stretch", material=name, cells=4, steps=4, stretch=2.0, nu=0.45,
            hessian=hessian, progress=False,
        )  # fmt: skip
        assert result.converged
        states.append(result)
    filtered, plain = states
    assert len(filtered.steps) == 4
    assert all(step["energy"] is None for step in filtered.steps)
    for a, b in zip(filtered.steps, plain.steps, strict=True):
        assert a["volume_ratio"] == pytest.approx(b["volume_ratio"], abs=1e-7)
        assert a["residual"] <= 1e-7 * filtered.problem.force_scale
    difference = filtered.problem.x - plain.problem.x
    assert difference.norm() <= 1e-5 * plain.problem.x.norm()


@pytest.mark.one_debian("serial")
@mpi
@pytest.mark.parametrize("name", ["filtered_neo_hookean", "neo_hookean"])
def test_a_filtered_stress_survives_inversion(name):
    """One face moves through the other: the plain energy is infinite, the filtered stress not."""
    result = run(
        "pull", material=name, cells=3, steps=1, hessian="clamp", predictor="none", progress=False,
        petsc={"snes_max_it": 400}, **{"move.0.translate": [-1.1, 0.0, 0.0]},
    )  # fmt: skip
    first = result.steps[0]
    if name == "neo_hookean":
        assert first["reason"] == "DIVERGED_FUNCTION_DOMAIN"
    else:
        # Rounding decides which end is found; one with inverted points says so.
        end = result.steps[-1]
        assert result.converged and (end["min_J"] <= 0) == ("inverted" in (end.get("notes") or []))
        assert first["newton"] > 5
