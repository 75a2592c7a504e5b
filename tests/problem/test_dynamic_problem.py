"""Motion in a dolfinx program: exact solutions, prescribed motion, failed steps, bad input."""

from __future__ import annotations

import re

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import Press, unit_cube, vector_space

import fem_snh
from fem_snh import _dolfinx
from fem_snh.choices import INTEGRATORS
from fem_snh.errors import BadInput

pytestmark = pytest.mark.mpi
TIGHT = {"snes_scaled_tol": 1e-12, "ksp_rtol": 1e-10}


def snh():
    return fem_snh.material("stable_neo_hookean", E=1.0, nu=0.45)


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("integrator", ["newmark", "semi_implicit"])
def test_a_weight_that_changes_in_time(comm, integrator):
    """Free fall under g(t) = t, as the integrators approximate u = -t^3 / 6."""
    domain = unit_cube(comm, 2)
    u = fem.Function(vector_space(domain))
    g = fem.Constant(domain, 0.0)
    m = snh()

    def set_time(t):
        g.value = t

    problem = fem_snh.DynamicProblem(
        u, {m: ufl.dx}, {m: 3.0}, integrator, duration=1.0, set_time=set_time,
        terms=[3.0 * g * u[2] * ufl.dx], petsc_options=TIGHT,
    )  # fmt: skip
    h, n = 0.05, 10
    for _ in range(n):
        assert problem.step(h)
    assert problem.time == pytest.approx(0.5, rel=1e-14)
    t = h * np.arange(1, n + 1)
    if integrator == "newmark":  # trapezoidal sums of the acceleration -t
        v = np.cumsum(-h * (t - h / 2))
        z = sum(h * w + h**2 / 4 * (-2 * s + h) for s, w in zip(t, [0, *v[:-1]], strict=True))
    else:
        z = np.cumsum(np.cumsum(-h * t))[-1] * h
    assert abs(u.x.array.reshape(-1, 3) - [0, 0, z]).max() <= 1e-8
    energies = problem.energies()
    assert energies["momentum"][2] == pytest.approx(3 * problem.v.x.array[2], rel=1e-6)
    if integrator == "newmark":
        assert energies["work"] == pytest.approx(-(0.5**4) / 8, rel=0.03)
        assert energies["numerical_dissipation"] == pytest.approx(0, abs=1e-12)


def test_prescribed_motion_and_a_failed_step(comm):
    """Velocity and acceleration are those of the motion; a failed step leaves the state."""
    program, m = Press(unit_cube(comm, 2), height=0.0), snh()

    def set_time(t):
        program.top.x.array[2::3] = -0.5 * t**2

    problem = fem_snh.DynamicProblem(
        program.u, {m: ufl.dx}, {m: 1.0}, duration=1.0, set_time=set_time, bcs=program.bcs,
        petsc_options=TIGHT,
    )  # fmt: skip
    for _ in range(4):
        assert problem.step(0.1)
    top = program.dofs(2, 1.0)
    values = [f.x.array.reshape(-1, 3)[top] for f in (problem.u, problem.v, problem.a)]
    for found, exact, error in zip(values, (-0.08, -0.4, -1.0), (1e-14, 1e-11, 1e-9), strict=True):
        assert abs(found - [0, 0, exact]).max(initial=0) <= error
    state = [f.x.array.copy() for f in (problem.u, problem.v, problem.a)]
    problem.solver.setTolerances(max_it=0)
    assert not problem.step(0.1)
    assert problem.reason.startswith("DIVERGED_MAX_IT")
    assert problem.reason == problem.reason.strip() and "\n" not in problem.reason
    for kept, f in zip(state, (problem.u, problem.v, problem.a), strict=True):
        assert np.array_equal(kept, f.x.array)
    problem.solver.setTolerances(max_it=50)
    assert problem.step(0.05)
    assert problem.time == pytest.approx(0.45)


BAD: list[tuple[dict, str]] = [
    *[({"densities": rho}, "material.density = ")
      for rho in (0, -1.0, np.nan, np.inf, True, "1", np.array([1.0]))],
    *[({"duration": t}, "time.duration = ") for t in (0.0, -1, np.nan, np.inf, True, None)],
    *[({"damping": (x, 0.0)}, "time.damping.mass = ") for x in (-1, np.nan, np.inf, True, "a")],
    ({"damping": (0.0, -0.1)}, "time.damping.stiffness = -0.1: expected a number >= 0"),
    *[({"damping": x}, "time.damping = ") for x in (0.1, (0.1,), (0.1, 0.1, 0.1), "ab", None)],
    ({"integrator": "euler"}, f"time.integrator = 'euler': expected one of {INTEGRATORS[0]}"),
    ({"integrator": "generalized_alpha", "rho_infinity": np.nan}, "time.rho_infinity = nan"),
    ({"integrator": "generalized_alpha", "rho_infinity": True}, "time.rho_infinity = True"),
    ({"rho_infinity": 0.5}, "time.rho_infinity = 0.5: expected no value"),
    ({"mass": "lump"}, "time.mass = 'lump': expected one of"),
    ({"set_time": 0.5}, "set_time = 0.5: expected a function"),
]  # fmt: skip


@pytest.mark.parametrize("arguments, message", BAD, ids=str)
def test_bad_arguments(comm, arguments, message):
    """Each is refused in one line on every rank."""
    u, m = fem.Function(vector_space(unit_cube(comm, 1))), snh()
    arguments = {"duration": 1.0} | arguments
    densities = {m: arguments.pop("densities", 1.0)}
    with pytest.raises(BadInput, match="^" + re.escape(message)) as error:
        fem_snh.DynamicProblem(u, {m: ufl.dx}, densities, **arguments)
    assert ": expected " in str(error.value) and "\n" not in str(error.value)


@pytest.mark.parametrize("by_hand", [False, True])
def test_a_base_that_a_program_moves(comm, by_hand):
    """Its reaction contains the inertia of its nodes, also if the program sets their values."""
    V = vector_space(unit_cube(comm, 1))
    u, base = fem.Function(V), fem.Function(V)
    m = fem_snh.material("stable_neo_hookean", E=1e8, nu=0.3)
    nodes = np.arange(len(u.x.array) // 3)
    w, n = 4 * np.pi, 40

    def set_time(t):
        base.x.array[::3] = 0.1 * np.sin(w * t)

    problem = fem_snh.DynamicProblem(
        u, {m: ufl.dx}, {m: 1000.0}, "newmark", duration=1.0,
        set_time=None if by_hand else set_time, bcs=[_dolfinx.prescribed(base, nodes)],
    )  # fmt: skip
    found = []
    for k in range(n):
        if by_hand:
            set_time((k + 1) / n)
        assert problem.step(1.0 / n)
        forces = problem._problem.x.duplicate()
        problem._problem.gradient(problem._problem.x, forces)
        found.append(comm.allreduce(forces.array_r[::3].sum()))
    exact = -1000 * 0.1 * w**2 * np.sin(w * np.arange(1, n + 1) / n)
    # Backward differences have the error 2/3 (w h)^2; those of the function are almost exact.
    allowed = (w / n) ** 2 if by_hand else 1e-4
    assert abs(found - exact)[5:].max() < allowed * abs(exact).max()
    kinetic = problem.energies()["kinetic"]
    assert kinetic == pytest.approx(500 * (0.1 * w) ** 2, rel=allowed)


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("element", ["Q1", "Q2Q1"])
def test_a_stored_state_continues_the_motion(comm, integrator, element, tmp_path):
    """The end is that of the uninterrupted motion; a state of another mesh is refused."""

    def swing(cells=2):
        domain = unit_cube(comm, cells)
        u = fem.Function(vector_space(domain, 2 if element == "Q2Q1" else 1))
        nodes = fem.locate_dofs_geometrical(u.function_space, lambda x: x[2] < 1e-9)
        g, m = fem.Function(u.function_space), snh()
        problem = fem_snh.DynamicProblem(
            u, {m: ufl.dx}, {m: 1.0}, integrator, duration=1.0, element=element,
            bcs=[_dolfinx.prescribed(g, nodes)], damping=(0.1, 0.05),
            terms=[fem_snh.Gravity([0.1, 0, 0], lambda t: np.sin(3 * t))], petsc_options=TIGHT,
        )  # fmt: skip
        return problem, g

    def advance(problem, base, steps):
        for k in steps:
            base.x.array[::3] = 0.02 * np.sin(0.2 * (k + 1))  # changed by hand
            assert problem.step(0.1)

    whole, base = swing()
    advance(whole, base, range(8))
    first, base = swing()
    advance(first, base, range(4))
    np.savez(tmp_path / f"{comm.rank}.npz", **first.state())
    second, base = swing()
    with np.load(tmp_path / f"{comm.rank}.npz") as stored:
        second.start(state=stored)
        assert second.time == pytest.approx(0.4)
        advance(second, base, range(4, 8))
        with pytest.raises(BadInput, match=r"rows of state\['unknowns'\] = "):
            swing(3)[0].start(state=stored)
    size = abs(whole.u.x.array).max(initial=0)
    assert abs(second.u.x.array - whole.u.x.array).max(initial=0) <= 1e-9 * size
    assert second.energies()["work"] == pytest.approx(whole.energies()["work"], rel=1e-7)
