"""Motions with an exact solution: free fall, one linear mode, prescribed motion."""

from __future__ import annotations

from math import atan, pi

import numpy as np
import pytest
from bodies import Condition, Hold
from motions import advance, displacement, equal_steps, moving, run

from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.regions import Filling
from fem_snh.choices import INTEGRATORS, MASSES
from fem_snh.kernels.material import material

mpi = pytest.mark.mpi
G, STEP, STEPS = 9.81, 0.01, 20
FALL = {"gravity": (0, 0, -G), "duration": STEPS * STEP}


def fallen(integrator: str) -> float:
    """Return the height after STEPS steps of STEP, started at rest."""
    n, h = STEPS, STEP
    if integrator in ("backward_euler", "semi_implicit"):
        return -G * h**2 * n * (n + 1) / 2
    if integrator == "bdf2":  # its recursion; the first step is backward Euler
        v, z = [0.0, -G * h], [0.0, -G * h**2]
        for _ in range(n - 1):
            v.append((4 * v[-1] - v[-2] - 2 * h * G) / 3)
            z.append((4 * z[-1] - z[-2] + 2 * h * v[-1]) / 3)
        return z[-1]
    return -G * (n * h) ** 2 / 2


FALLS = [(integrator, "Q1") for integrator in INTEGRATORS]
FALLS += [("backward_euler", "P1"), ("semi_implicit", "P2P1")]
FALLS += [("newmark", element) for element in ELEMENTS if element != "Q1"]
ON_RANKS = [("generalized_alpha", "P2P1"), ("bdf2", "P1")]


@pytest.mark.one_debian("serial")
@pytest.mark.parametrize(
    "integrator, element", [*FALLS, *(pytest.param(*pair, marks=mpi) for pair in ON_RANKS)]
)
def test_free_fall(integrator, element):
    """Backward Euler: -g h^2 n (n + 1) / 2; Newmark: the parabola; both to 1e-8."""
    p, d = moving(integrator, element, **FALL)
    d.start(p)
    run(p, d, STEPS)
    z = displacement(p) - [0, 0, fallen(integrator)]
    assert abs(z).max(initial=0) <= 1e-8
    assert abs(d.a.x.array.reshape(-1, 3) - [0, 0, -G]).max(initial=0) <= 1e-6
    if integrator == "newmark":
        assert abs(d.v.x.array.reshape(-1, 3)[:, 2] + G * STEPS * STEP).max(initial=0) <= 1e-8


#: Of an amplitude of 1: those of `advance`'s solvers.
ACCURACY = dict.fromkeys(INTEGRATORS, 1e-12) | {"semi_implicit": 1e-10}
#: omega h of the linear mode, and its number of steps: one period.
ANGLE, PERIOD = 2 * pi / 40, 40


def linear_mode(integrator: str, mass: str, damping: tuple[float, float], steps: int):
    """Return (position, velocity / omega) of one mode after each step of omega h = ANGLE.

    One cell that is confined to move along z: its stress is linear in the stretch. The mass of the
    moving face is a third of the cell's (consistent) or a half (lumped). ``damping`` has the ratios
    to critical damping of the mass's and of the stiffness's part.
    """
    E, nu, rho, amplitude = 3.0, 0.45, 2.0, 0.2
    modulus = E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))
    omega = np.sqrt(modulus / (rho * {"consistent": 1 / 3, "lumped": 1 / 2}[mass]))
    hold = [Hold("body", ("x", "y")), Hold("bottom")]
    fillings = [Filling(material("stable_neo_hookean", E=E, nu=nu), None, rho)]
    factors = 2 * damping[0] * omega, 2 * damping[1] / omega
    p, d = moving(integrator, fillings=fillings, hold=hold, mass=mass, damping=factors,
                  duration=steps * ANGLE / omega)  # fmt: skip
    top = p.coordinates[:, 2] > 0.5
    p.x.array[: p.coordinates.size].reshape(-1, 3)[top, 2] = amplitude
    d.start(p)
    for _ in advance(p, d, equal_steps(steps)):
        v = d.v.x.array.reshape(-1, 3)[: len(top)]
        found = p.comm.allgather(np.column_stack([displacement(p)[top, 2], v[top, 2] / omega]))
        values = np.concatenate(found) / amplitude
        assert np.ptp(values, axis=0).max() <= ACCURACY[integrator]
        yield values.mean(axis=0)


def recurrence(integrator: str, ratio: float, steps: int):
    """Return position and velocity of q'' + 2 ratio q' + q = 0 after each step of h = ANGLE.

    The textbooks' formulas, as linear systems for (q, v, a); q = 1 and v = 0 at the start.
    """
    h, c = ANGLE, 2 * ratio
    y = [np.array([1.0, 0.0, -1.0])]
    rho = 0.8  # the default spectral radius
    alpha_m, alpha_f = (2 * rho - 1) / (rho + 1), rho / (rho + 1)
    if integrator == "newmark":
        alpha_m = alpha_f = 0.0
    gamma, beta = 0.5 - alpha_m + alpha_f, 0.25 * (1 - alpha_m + alpha_f) ** 2
    balance = np.array([1.0, c, 1.0])  # q + c v + a
    for n in range(steps):
        (q, v, a), rows = y[-1], np.zeros((3, 3))
        if integrator in ("newmark", "generalized_alpha"):  # Chung & Hulbert 1993, eq. 3 to 8
            rows[0] = 1, 0, -beta * h**2
            rows[1] = 0, 1, -gamma * h
            rows[2] = balance * [1 - alpha_f, 1 - alpha_f, 1 - alpha_m]
            right = [q + h * v + h**2 * (0.5 - beta) * a, v + h * (1 - gamma) * a]
            right.append(-balance * [alpha_f, alpha_f, alpha_m] @ y[-1])
        else:  # of the system of first order; BDF2 after a first step of backward Euler
            bdf2 = integrator == "bdf2" and n > 0
            k, known = (1.5, 2 * y[-1] - 0.5 * y[-2]) if bdf2 else (1.0, y[-1])
            rows[0], rows[1], rows[2] = (k, -h, 0), (0, k, -h), balance
            right = [known[0], known[1], 0.0]
        y.append(np.linalg.solve(rows, right))
    return np.array(y)[1:, :2]


@pytest.mark.one_debian("serial")
@pytest.mark.parametrize("damping", [(0.0, 0.0), (0.05, 0.1)], ids=["undamped", "damped"])
@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_one_linear_mode(integrator, mass, damping):
    """Each step is the integrator's own recurrence, also with a damping ratio of 0.15.

    Undamped, after one period: amplitude 0.614165724 of backward Euler, phase 6.270314 of Newmark.
    """
    found = np.array(list(linear_mode(integrator, mass, damping, PERIOD)))
    expected = recurrence(integrator, sum(damping), PERIOD)
    assert abs(found - expected).max() <= ACCURACY[integrator]
    position, velocity = found[-1]
    amplitude, phase = np.hypot(position, velocity), np.arctan2(-velocity, position) % (2 * pi)
    if any(damping):
        return
    if integrator in ("backward_euler", "semi_implicit"):
        assert amplitude == pytest.approx((1 + ANGLE**2) ** -20, abs=1e-10)
        assert amplitude == pytest.approx(0.614165724, abs=1e-9)
        assert phase == pytest.approx(40 * atan(ANGLE), abs=1e-10)
    elif integrator == "newmark":
        assert amplitude == pytest.approx(1, abs=1e-12)
        assert phase == pytest.approx(80 * atan(ANGLE / 2), abs=1e-12)
        assert phase == pytest.approx(6.270314, abs=1e-6)


@mpi
@pytest.mark.parametrize("before", [0.0, 0.3, 0.03, 1e-6])
def test_a_kink_within_a_step(before):
    """The acceleration contains the whole change of velocity, wherever in a step the kink is.

    The motion: 0.1 t^2, then 0.4 m/s back, from a time that is ``before`` of a step before 0.75 s.
    """
    duration, h = 2.0, 0.25
    kink = 0.75 - before * h

    def path(X, load):
        t = duration * load
        z = 0.1 * t**2 if t <= kink else 0.1 * kink**2 - 0.4 * (t - kink)
        return np.outer(np.ones(len(X)), [0, 0, z])

    p, d = moving("newmark", hold=[Hold("bottom")], move=[Condition("top", path)],
                  duration=duration)  # fmt: skip
    d.start(p)
    top = abs(p.V.tabulate_dof_coordinates()[:, 2] - 1) < 1e-12
    sums = 0.2 * h / 2
    for load in advance(p, d, equal_steps(8)[:6]):
        t = duration * load
        v, a = (f.x.array.reshape(-1, 3)[top, 2] for f in (d.v, d.a))
        sums = sums + h * a
        if abs(t - kink) >= h:
            assert abs(v - (0.2 * t if t < kink else -0.4)).max(initial=0) <= 1e-11
            assert abs(a - (0.2 if t < kink else 0.0)).max(initial=0) <= 1e-9
    assert abs(sums - (-0.4)).max(initial=0) <= 1e-5


@mpi
@pytest.mark.parametrize("spacing", [1e-4, 2e-4, 1e-3, 0.0125])
@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_inertial_forces_of_a_motion_by_a_table(integrator, spacing):
    """A stiff cube on a base that a record moves: its reaction is m a, for any spacing of it."""
    w, steps = 4 * np.pi, 40
    times = np.arange(0, 1 + spacing, spacing)
    record = 0.1 * np.sin(w * times)

    def path(X, load):
        return np.outer(np.ones(len(X)), [np.interp(load, times, record), 0, 0])

    p, d = moving(integrator, hold=[], move=[Condition("body", path)], duration=1.0)
    d.start(p)
    found = []
    for _ in advance(p, d, equal_steps(steps)):
        forces = p.x.duplicate()
        p.gradient(p.x, forces)
        found.append(p.comm.allreduce(forces.array_r[::3].sum()))
    exact = -2.0 * 0.1 * w**2 * np.sin(w * np.arange(1, steps + 1) / steps)
    assert found == pytest.approx(exact, abs=(w / steps) ** 2 / 3 * abs(exact).max())


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("element", [pytest.param("P1", marks=mpi), "P2P1"])
def test_prescribed_nodes_move_as_prescribed(element, integrator):
    """Positions to 1e-14, velocities and accelerations of the motion: t^3, then rest, in m."""
    duration, kink = 2.0, 0.75

    def path(X, load):
        t = duration * min(load, kink)
        return np.outer(np.ones(len(X)), [0.05 * t**3, 0, 0.1 * t**2])

    p, d = moving(integrator, element, hold=[Hold("bottom")], move=[Condition("top", path)],
                  duration=duration)  # fmt: skip
    d.start(p)
    nodes = p.V.tabulate_dof_coordinates()
    top = abs(nodes[:, 2] - 1) < 1e-12
    own = top[: len(p.coordinates)]
    assert abs(d.a.x.array.reshape(-1, 3)[top] - [0, 0, 0.2]).max(initial=0) <= 1e-5
    for load in advance(p, d, equal_steps(8)):
        t, moves = duration * min(load, kink), load < kink
        exact = path(nodes[: len(own)][own], load)
        assert abs(displacement(p)[own] - exact).max(initial=0) <= 1e-14
        if load == kink:
            continue
        v, a = d.v.x.array.reshape(-1, 3)[top], d.a.x.array.reshape(-1, 3)[top]
        assert abs(v - moves * np.array([0.15 * t**2, 0, 0.2 * t])).max(initial=0) <= 1e-11
        assert abs(a - moves * np.array([0.3 * t, 0, 0.2])).max(initial=0) <= 1e-9
