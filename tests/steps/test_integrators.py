"""The integrators' formulas on one degree of freedom: orders, variable steps, errors, spectra."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from fem_snh.choices import INTEGRATORS
from fem_snh.steps.dynamics.integrators import Before, MotionState, create

pytestmark = pytest.mark.one_debian

ORDERS = {
    "backward_euler": 1, "semi_implicit": 1, "newmark": 2, "bdf2": 2, "generalized_alpha": 2
}  # fmt: skip
START = np.array([1.0]), np.array([0.3])


def force(u):
    """A pendulum's: a + sin(u) = 0."""
    return np.sin(u)


def pendulum(integrator, steps, force=force):
    """Yield (formulas, state, u, v, a) of each of these steps, their balance of forces solved."""
    u, v = START
    a, before = -force(u), None
    for h in steps:
        u0, state = u, MotionState(u, v, a, before)
        f = integrator.formulas(h, state)
        k1, k0 = f.inertia

        def balance(x, f=f, u=u, k1=k1, k0=k0):
            inertia = k1 * f.acceleration(x) + k0 * f.old_acceleration
            return inertia + force(x) + f.old_forces * force(u)

        u = np.array([solved(balance)])
        v, a, before = f.velocity(u), f.acceleration(u), Before(h, u0, v, f.old_acceleration)
        yield f, state, u, v, a


def solved(balance):
    """Return the zero of a function of arrays (1,)."""
    return brentq(lambda x: float(balance(np.array([x]))[0]), -10, 10, xtol=1e-15, rtol=1e-15)


def exact(time, u=START[0], v=START[1]):
    found = solve_ivp(lambda t, y: [y[1], -np.sin(y[0])], (0, time), [u[0], v[0]], method="DOP853",
                      rtol=1e-13, atol=1e-14)  # fmt: skip
    return found.y[:, -1]


@pytest.mark.parametrize("pattern", [(1.0,), (1.0, 1.8, 0.5)], ids=["equal", "unequal"])
@pytest.mark.parametrize("name", INTEGRATORS)
def test_orders(name, pattern):
    """Displacement and velocity of a pendulum converge with the order, also with unequal steps."""
    errors = []
    for n in (60, 120, 240):
        steps = np.resize(pattern, n)
        *_, u, v, _ = list(pendulum(create(name), 2 * steps / steps.sum()))[-1]
        errors.append(np.abs(np.array([u[0], v[0]]) - exact(2.0)))
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    assert orders[-1] == pytest.approx(ORDERS[name], abs=0.1)


@pytest.mark.parametrize("name", INTEGRATORS)
def test_the_estimated_error_is_that_of_a_step(name):
    """Against the exact solution from the step's own start, as h goes to 0."""
    ratios = []
    for h in (0.02, 0.01):
        f, state, u, _, a = list(pendulum(create(name), [h] * 60))[-1]
        if name == "bdf2":  # its formula contains the step before, too: both start exactly
            now = exact(h, state.u, state.v)
            before = Before(h, state.u, state.v, state.a)
            f = create(name).formulas(h, MotionState(now[:1], now[1:], -force(now[:1]), before))
            u = np.array([solved(lambda x, f=f: f.acceleration(x) + force(x))])
            a, true = f.acceleration(u), u - exact(2 * h, state.u, state.v)[0]
        else:
            true = u - exact(h, state.u, state.v)[0]
        estimate = f.error[0] * a + f.error[1] * f.old_acceleration
        ratios.append(float((estimate / true)[0]))
    assert ratios[0] == pytest.approx(1, abs=0.1)
    assert ratios[1] == pytest.approx(1, abs=0.05)


@pytest.mark.parametrize("rho", [0.0, 0.3, 0.8, 1.0])
def test_spectral_radius_at_infinite_frequency(rho):
    """One step of u'' = -omega^2 u with omega h = 1e6: the largest eigenvalue's modulus is rho."""
    integrator, omega, columns = create("generalized_alpha", rho), 1e6, []
    for start in np.eye(3):  # u, v / omega, a / omega^2
        u, v, a = (np.array([x]) for x in start * [1, omega, omega**2])
        f = integrator.formulas(1.0, MotionState(u, v, a))
        k1, k0 = f.inertia
        c, w = f.acceleration.rate, f.acceleration.origin
        x = (k1 * c * w - k0 * a - f.old_forces * omega**2 * u) / (k1 * c + omega**2)
        columns.append([x, f.velocity(x) / omega, f.acceleration(x) / omega**2])
    amplification = np.array(columns)[:, :, 0].T
    assert abs(np.linalg.eigvals(amplification)).max() == pytest.approx(rho, abs=2e-3)
