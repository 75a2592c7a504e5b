"""Materials and filters at extreme deformations, compared with mpmath."""

from __future__ import annotations

from functools import lru_cache

import mpmath
import numpy as np
import pytest
import sympy
from points import every_name, exact, make

from benchmarks import point_bounds, pointwise
from benchmarks.point_bounds import exactly, norm
from benchmarks.pointwise import deformations
from fem_snh.assembly.cell_loops import CellLoops, ElementTables, compile_cell_loops
from fem_snh.kernels.codegen.derivatives import DividedDifference
from fem_snh.kernels.codegen.small_strain import Increments
from fem_snh.kernels.material import material
from fem_snh.materials.invariants import SIGMA

pytestmark = pytest.mark.one_debian

STIFF = 0.4999999
BY_HAND = ["stable_neo_hookean", "neo_hookean"]


# --- every material ------------------------------------------------------------------------------


@every_name
def test_bounds_hold(name, request):
    if name == "van_der_waals":
        reason = "its curvature below x = 1e-4 cancels between I_C, II_C and J"
        request.applymarker(pytest.mark.xfail(strict=True, reason=reason))
    rows = pointwise.measure(name, quick=True)
    broken = [(r["quantity"], r["group"], r["nu"], r["ratio"]) for r in rows if not r["passed"]]
    assert not broken
    decided = [r["digits"] for r in rows if r["group"] in ("regular", "near-equal 1e-08")]
    assert all(decided) and len(decided) > 10  # the bounds leave something to compare


@every_name
def test_a_strain_of_1e_9_keeps_six_digits_of_stress(name):
    """At every nu, also where F changes shape alone and lambda is five million mu."""
    chosen = dict.fromkeys([0.3, STIFF])
    for nu in chosen:
        m = make(name, nu)
        for seed in (0, 1, 2):  # symmetric, any, free of volume
            F = deformations(seed)["strain 1e-09"]
            with mpmath.workdps(90):
                P = exact(m, F).P
                assert norm(exactly(m.pk1(F)) - P) <= 1e-6 * norm(P)


@pytest.mark.parametrize("name", ["stable_neo_hookean", "stvk", "filtered_neo_hookean"])
def test_a_wrong_constant_breaks_the_bounds(name):
    m = make(name, 0.3)
    m.constants = m.constants * (1 + 1e-11)
    _, F, points = next(pointwise.samples(m, 0))
    with mpmath.workdps(60):
        broken = {c.quantity for c in point_bounds.compare(m, F, points) if c.ratio > 1}
    assert {"pk1", "hessian exact"} <= broken
    make.cache_clear()


# --- losses of accuracy, repaired ---------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["stable_neo_hookean", "neo_hookean_ciarlet", "corotational", "hencky"]
)
@pytest.mark.parametrize("strain", [1e-9, 1e-12, 1e-15])
def test_near_rest_nothing_cancels(name, strain):
    """Stress to nine digits, energy to its first-order terms, of any strain: lambda = 5e6 mu."""
    m = make(name, STIFF)
    A = np.array([[0.5, -0.25, 0.75], [0.125, 0.25, -0.5], [0.5, 1.0, -0.75]])  # tr A = 0
    F = np.eye(3) + 2.0 ** round(np.log2(strain)) * A
    with mpmath.workdps(90):
        point = exact(m, F)
        assert norm(exactly(m.pk1(F)) - point.P) <= 1e-9 * norm(point.P)
        assert abs(m.energy(F) - point.energy) <= 1e-15 * m.expression.E * strain


@pytest.mark.parametrize("name", ["hencky", "ogden", "peng_landel", "seth_hill", "valanis_landel"])
@pytest.mark.parametrize("apart", [1e-3, 1e-4, 2e-5, 1e-6, 1e-9])
def test_near_equal_stretches_keep_their_digits(name, apart):
    """Where the division loses digits and its limit has not begun: it was ten digits at 1e-5."""
    m = make(name, 0.3)
    F = np.diag([1.3 + apart, 1.3, 0.7])
    with mpmath.workdps(90):
        values = np.array([float(x) for x in exact(m, F).eigenvalues])
    assert abs(np.sort(m.eigensystem(F)[0]) - values).max() <= 2e-14 * abs(values).max()


def kinked(s0, s1, s2, mu, lam):
    """Every rule of the calculus: a power, a root, log, exp, a quotient, a product of sums."""
    x, y, z = s0, s1, s2
    parts = [
        s ** sympy.Rational(7, 3) + sympy.log(s + 2) * sympy.exp(s / 3) - 1 / s for s in (x, y, z)
    ]
    return (
        mu * sum(parts)
        + lam * sum(parts) ** 2
        + lam * sympy.sqrt(x * y * z + 1)
        - mu * (x * y * z) ** 3
    )


def test_divided_differences_are_exact():
    """[f] (x - y) = f - f', and the limit where x = y, for an expression with every rule in it."""
    x, y, z = SIGMA
    f = sympy.diff(kinked(x, y, z, 2, 3), x)
    functions = {
        "log1p_over_x": lambda t: mpmath.log1p(t) / t,
        "expm1_over_x": lambda t: mpmath.expm1(t) / t,
        "powm1_over_x": lambda t, a: mpmath.expm1(a * mpmath.log1p(t)) / t,
    }
    divided = sympy.lambdify(SIGMA, DividedDifference(x, y)(f), [functions, "mpmath"])
    call = sympy.lambdify(SIGMA, f, "mpmath")
    with mpmath.workdps(60):
        for a, b in ((1.5, 0.5), (1.25, 1.25 - 2.0**-30), (0.75, 0.75 + 2.0**-50)):
            a, b, c = map(mpmath.mpf, (a, b, 0.9))
            expected = (call(a, b, c) - call(b, a, c)) / (a - b)
            assert abs(divided(a, b, c) - expected) < mpmath.mpf(10) ** -40


def test_changes_from_rest_are_exact():
    """f0 + df = f for an expression with every rule in it, df without a constant."""
    d = sympy.symbols("d0:3", real=True)
    f = kinked(*SIGMA, 2, 3)
    at_rest, change = Increments({s: (sympy.Integer(1), t) for s, t in zip(SIGMA, d, strict=True)})(
        f
    )
    call, moved = sympy.lambdify(SIGMA, f, "mpmath"), sympy.lambdify(d, change, "mpmath")
    with mpmath.workdps(60):
        for h in ((0.1, -0.05, 0.08), (1e-9, 2e-9, -3e-9)):
            h = list(map(mpmath.mpf, h))
            expected = call(*(1 + x for x in h)) - mpmath.mpf(sympy.N(at_rest, 60))
            assert abs(moved(*h) - expected) < mpmath.mpf(10) ** -50
    assert moved(0, 0, 0) == 0


@lru_cache
def tetrahedron(name: str, volume: str, nu: float):
    """The kernel loops on the reference tetrahedron with one point, and the material."""
    m = material(name, E=1.0, nu=nu)
    g = np.array([[-1.0, -1, -1], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    nodes = np.arange(4, dtype=np.int32)[None]
    corners = np.maximum(g, 0)
    corners[0] = 0
    t = ElementTables(nodes, nodes, corners, g[None], g[None], np.array([1 / 6]), volume)
    return CellLoops(compile_cell_loops(m, t), t), m


@pytest.mark.parametrize("volume", ["pointwise", "mean"])
@pytest.mark.parametrize("name", BY_HAND)
@pytest.mark.parametrize("strain", [1e-4, 1e-9, 1e-12, 1e-150])
def test_a_displacement_of_any_strain_keeps_its_residual(name, volume, strain):
    """grad u is not rounded to I + grad u on its way: no volume change, lambda = 5e6 mu."""
    loops, m = tetrahedron(name, volume, STIFF)
    H = strain * np.array([[0.5, -0.25, 0.75], [0.125, 0.25, -0.5], [0.5, 1.0, -0.75]])
    r = np.zeros((4, 3))
    loops.residual(np.concatenate([np.zeros((1, 3)), H.T]).ravel(), r.ravel())
    with mpmath.workdps(400 if strain < 1e-100 else 90):
        P = exact(m, exactly(np.eye(3)) + exactly(H)).P
        assert norm(exactly(6 * r[1:].T) - P) <= 1e-9 * norm(P)
