"""Rigid parts in time: a free top, a pendulum on a spring, a weight on a bar."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import unit_cube, vector_space
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import fem_snh
from fem_snh.geometry.rotations import exponential, skew
from fem_snh.scenes import Scene
from fem_snh.tables.amplitudes import Amplitude

mpi = pytest.mark.mpi

SIDES, DENSITY = np.array([1.0, 0.6, 0.3]), 1000.0
SPIN, DRIFT = np.array([0.3, 4.0, 0.2]), np.array([0.1, 0.2, 0.0])


def box(comm, integrator, duration, **rigid):
    """Return a rigid box in time, which has a weight if anything holds it."""
    domain = unit_cube(comm, 2)
    domain.geometry.x[:] *= SIDES
    u = fem.Function(vector_space(domain))
    m = fem_snh.material("stable_neo_hookean", E=1e6, nu=0.45)
    body = fem_snh.Rigid(ufl.dx, name="box", **rigid)
    weight = [fem_snh.Gravity([0, 0, -9.81])] if rigid else []
    keys: Any = {"duration": duration, "terms": [body, *weight]}
    return fem_snh.DynamicProblem(u, {m: ufl.dx}, {m: DENSITY}, integrator, **keys)


def moments_of_inertia():
    squares = SIDES**2
    return DENSITY * SIDES.prod() / 12 * (squares.sum() - squares)


def euler_top(duration):
    """Return the rotation of a free top, by Euler's equations in the body's axes."""
    inertia = moments_of_inertia()

    def rates(t, y):
        turning = y[3:].reshape(3, 3) @ skew(y[:3])
        return [*np.cross(inertia * y[:3], y[:3]) / inertia, *turning.ravel()]

    start = np.concatenate([SPIN, np.eye(3).ravel()])
    found = solve_ivp(rates, (0, duration), start, rtol=1e-11, atol=1e-12)
    return found.y[3:, -1].reshape(3, 3)


@pytest.mark.one_debian
@pytest.mark.parametrize(
    "integrator, size, ratio",
    [("newmark", 0.021, 3.6), ("bdf2", 0.26, 3.6), ("generalized_alpha", 0.0076, 2.8)],
)
def test_free_top_precesses(comm, integrator, size, ratio):
    """It turns about its intermediate axis by more than a turn; the error is of second order."""
    errors, exact = [], euler_top(2.0)
    for steps in (50, 100):
        problem = box(comm, integrator, 2.0)
        problem.start(lambda X: np.cross(SPIN, X - SIDES / 2) + DRIFT)
        before = problem.dynamics.energies(problem._problem)
        for _ in range(steps):
            assert problem.step(2.0 / steps)
        state = problem._problem.rigid_states(problem.x)["box"]
        after = problem.dynamics.energies(problem._problem)
        turned = exponential(np.array(state["rotation"])) @ exact.T
        errors.append(Rotation.from_matrix(turned).magnitude())
        assert state["position"] == pytest.approx(SIDES / 2 + 2.0 * DRIFT, abs=1e-9)
        assert after["momentum"] == pytest.approx(before["momentum"], abs=1e-7)
    assert errors[0] < size and errors[1] < errors[0] / ratio
    if integrator == "newmark":
        spin = np.array(before["angular_momentum"])
        assert after["kinetic"] == pytest.approx(before["kinetic"], rel=2e-5)
        assert abs(after["angular_momentum"] - spin).max() < 1e-4 * np.linalg.norm(spin)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("integrator", ["newmark", "generalized_alpha"])
def test_pendulum_on_a_spring(comm, integrator):
    """A box on a hinge with a torsion spring, released where the spring is at rest."""
    hinge = {"kind": "hinge", "axis": (0, 1, 0), "through": (0.0, 0.3, 0.15)}
    stiffness, duration, steps = 700.0, 0.6, 30
    problem = box(comm, integrator, duration, joint=hinge, spring={"rotation": stiffness})
    problem.start()
    for _ in range(steps):
        assert problem.step(duration / steps)
    mass, arm = DENSITY * SIDES.prod(), SIDES[0] / 2
    inertia = moments_of_inertia()[1] + mass * arm**2

    def rates(t, y):
        return [y[1], (mass * 9.81 * arm * np.cos(y[0]) - stiffness * y[0]) / inertia]

    exact = solve_ivp(rates, (0, duration), [0.0, 0.0], rtol=1e-10, atol=1e-12).y[:, -1]
    state = problem._problem.rigid_states(problem.x)["box"]
    assert exact[0] > 1
    assert state["rotation"] == pytest.approx([0, exact[0], 0], abs=2e-3)
    assert state["position"] == pytest.approx(hinge["through"], abs=1e-12)


def swing(integrator, *materials):
    """Return the steps of a bar that swings, one half of which is rigid."""
    soft = {"name": "stable_neo_hookean", "E": 1e5, "nu": 0.3, "density": 1000.0}
    scene = Scene(
        name="swing", cells=2, element="Q1", material=[soft, *materials], hold=[{"group": "left"}],
        mesh={"source": "bar", "parameters": {"length": 2.0, "interface": 1.0}},
        gravity={"vector": (0, 0, -9.81)}, rigid=[{"group": "second", "force": (0.0, 200.0, 0.0)}],
        time={"duration": 0.3, "steps": 6, "integrator": integrator},
    )  # fmt: skip
    whole = fem_snh.run(scene, progress=False)
    assert whole.converged
    return whole.steps


@mpi
@pytest.mark.parametrize("integrator", ["newmark", "generalized_alpha"])
def test_energy_of_a_bar_with_a_rigid_weight(comm, integrator):
    """It is kept up to the integrator's own error.

    The weight's material is not assembled: stiffness does not matter, only its mass.
    """
    last = swing(integrator)[-1]
    assert last["min_J"] < 1
    assert abs(last["numerical_dissipation"]) < 0.02 * last["kinetic"]
    stiff = {"name": "neo_hookean", "E": 1e12, "nu": 0.2, "density": 1000.0, "group": "second"}
    state = swing(integrator, stiff)[-1]["rigid"]["second"]
    assert state["position"] == pytest.approx(last["rigid"]["second"]["position"], abs=1e-9)


@mpi
@pytest.mark.parametrize("integrator", ["bdf2", "newmark", "generalized_alpha"])
def test_force_on_a_part_that_a_coarse_record_moves(comm, integrator):
    """It is m a, with steps a quarter of the distance of the points, if these are interpolated."""
    w, steps, points = 4 * np.pi, 80, np.linspace(0, 1, 21)
    values = np.column_stack([points, np.sin(w * points)]).tolist()
    record = Amplitude(name="record", points=values, interpolation="smooth")
    problem = box(comm, integrator, 1.0, translate=(0.1, 0, 0), table=record.value)
    problem.start()
    size, found = 0.1 * w**2 * DENSITY * SIDES.prod(), []
    for _ in range(steps):
        assert problem.step(1.0 / steps)
        forces = problem._problem.x.duplicate()
        problem._problem.gradient(problem._problem.x, forces)
        found.append(problem._problem.rigid.states(problem._problem.x, forces)["box"]["force"][0])
    exact = -size * np.sin(w * np.arange(1, steps + 1) / steps)
    # The second derivative of a cubic spline is off by (w h)^2 / 12, more beside its ends.
    inside = slice(8, -8)
    assert abs(np.array(found) - exact)[inside].max() < 1.5 * (w / 20) ** 2 / 12 * size
    linear = record.model_copy(update={"interpolation": "linear"})
    assert linear.has_kinks(1 / steps) and not linear.has_kinks(1 / 20)
    assert not record.has_kinks(1 / steps)
