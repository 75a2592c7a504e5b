"""The tolerance relative to the forces that act: small loads, local contact, scale, no loads."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from dolfinx_programs import Bar, Press, unit_cube
from running import solve

import fem_snh
from fem_snh.problem.definition import define
from fem_snh.scenes import Scene

pytestmark = pytest.mark.mpi

#: The default of -snes_scaled_tol, and of the residual relative to the forces that act.
SCALED, ACTING = 1e-7, 1e-4


def indented(depth: float, method: str, **petsc: float) -> tuple[float, dict[str, Any]]:
    """Return force and row of a rigid ball (R = 1) in a block of 80 contact radii; E = 1e5."""
    radius = depth**0.5
    ball = {"center": [0, 0, 1], "radius": 1}
    zone = {"radius": 80 * radius, "zone": 1.25 * radius, "order": 2, "flat": 1}
    scene = {
        "name": "indented", "mesh": {"source": "indenter", "parameters": zone}, "cells": 3,
        "element": "P2", "material": {"name": "stable_neo_hookean", "E": 1e5, "nu": 0.3},
        "hold": [
            {"group": "x = 0", "components": ["x"]}, {"group": "y = 0", "components": ["y"]},
            {"group": "surface"},
        ],
        "obstacle": [
            {"name": "ball", "group": "z = 0", "shape": {"sphere": ball}, "method": method,
             "translate": [0, 0, -depth]}
        ],
        "petsc": petsc,
    }  # fmt: skip
    row = solve(Scene.model_validate(scene)).steps[-1]
    return 4 * abs(row["obstacles"]["ball"]["force"][2]), row


@pytest.mark.one_debian("serial")
@pytest.mark.parametrize("method", ["penalty", "augmented_lagrangian"])
@pytest.mark.parametrize("depth", [1e-3, 1e-6])
def test_hertz(depth: float, method: str) -> None:
    """The force is that of a tight solve; at 1e-6 R it is 2e-7 E V^(2/3), twice the tolerance."""
    force, row = indented(depth, method)
    tight, _ = indented(depth, method, snes_scaled_tol=1e-13)
    assert force == pytest.approx(tight, rel=1e-3)
    assert force == pytest.approx(4 / 3 * 1e5 / (1 - 0.3**2) * depth**1.5, rel=0.03)
    assert row["residual"] <= row["tolerance"] < 1e-2 * SCALED * 1e5 * (80**2 * depth)


def loaded(E: float, load: float, **keys: Any) -> Any:
    """Return the result of a cube on rollers, pulled by a traction of ``load`` E."""
    rollers = [
        {"group": group, "components": [axis]}
        for group, axis in (("left", "x"), ("front", "y"), ("bottom", "z"))
    ]
    common = {
        "name": "pulled", "mesh": {"source": "cube"}, "cells": 2, "element": "Q1", "hold": rollers,
        "material": {"name": "stable_neo_hookean", "E": E, "nu": 0.3}, "predictor": "none",
        "traction": [{"group": "right", "vector": [load * E, 0, 0]}],
    }  # fmt: skip
    return solve(Scene.model_validate(common | keys))


@pytest.mark.one_debian
@pytest.mark.parametrize("E", [1.0, 1e9, 1e-6])
def test_a_small_load_is_not_ignored(E: float) -> None:
    """Hooke's stretch; the residual of the undeformed cube is below 1e-7 E V^(2/3)."""
    found = loaded(E, 1e-8, petsc={"snes_forcing_max": 1e-6})
    row = found.steps[0]
    X = found.problem.coordinates
    stretched = 1e-8 * X * [1, -0.3, -0.3]
    assert found.problem.x.array_r == pytest.approx(stretched.ravel(), abs=1e-12)
    assert 1 <= row["newton"] <= 2
    # Nodal forces on the right face: 1/16 at corners, 1/8 at edges, 1/4 in the middle; the
    # reactions of the left face are the same.
    force = 1e-8 * E * np.sqrt(2 * (4 / 16**2 + 4 / 8**2 + 1 / 4**2))
    assert row["tolerance"] == pytest.approx(ACTING * force, rel=1e-3)
    assert row["residual"] <= row["tolerance"]


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("nu", [0.49, 0.4999999999, 0.5])
def test_an_unknown_pressure_has_one_tolerance_for_every_nu(nu: float) -> None:
    """No force has the factor lambda, whose rounding would exceed that of the load."""
    material = {"name": "stable_neo_hookean", "E": 1.0, "nu": nu}
    found = loaded(1.0, 1e-6, element="Q2Q1", material=material)
    row = found.steps[0]
    assert row["residual"] <= row["tolerance"] < ACTING * 1e-6
    # Taylor-Hood contains the exact solution, a homogeneous state of J = 1 at nu = 0.5.
    assert found.problem.measures(found.problem.x)["max_u"] == pytest.approx(
        1e-6 * np.sqrt(1 + 2 * nu**2), rel=1e-3
    )


def test_no_load_at_all() -> None:
    """At rest no iteration is made; from a disturbed start the residual falls to rounding."""
    row = loaded(1.0, 0.0).steps[0]
    assert row["converged"] and row["newton"] == 0
    row = loaded(1.0, 0.0, start={"noise": 1e-3, "seed": 1}).steps[0]
    assert row["converged"] and row["residual"] <= row["tolerance"] < 1e-12 and row["max_u"] < 1e-9


@pytest.mark.one_debian
@pytest.mark.parametrize("E", [1.0, 1e9])
@pytest.mark.parametrize("size", [1.0, 1e-3])
@pytest.mark.parametrize("with_material", [True, False])
def test_programs_have_the_same_tolerance(
    comm: Any, with_material: bool, size: float, E: float
) -> None:
    """Hooke's stretch under a force per volume, also if the elastic energy is a UFL form."""
    domain = unit_cube(comm, 2)
    body = Bar(domain, pull=0.0)
    domain.geometry.x[:] *= size
    material = fem_snh.material("stable_neo_hookean", E=E, nu=0.0)
    modulus, load = fem.Constant(domain, E), fem.Constant(domain, 1e-8 * E / size)
    strain = ufl.sym(ufl.grad(body.u))
    terms = [-load * body.u[0] * ufl.dx]
    if not with_material:  # nu = 0
        terms.append(modulus * ufl.inner(strain, strain) / 2 * ufl.dx)
    problem = fem_snh.NonlinearProblem(
        body.u, {material: ufl.dx} if with_material else {}, bcs=body.bcs[:3], terms=terms
    )
    problem.solve()
    assert problem.reason == "CONVERGED_FNORM_ABS"
    points = body.V.tabulate_dof_coordinates()
    x = points[: len(body.u.x.array) // 3, 0]
    exact = 1e-8 * (x - x**2 / (2 * size))  # the finite elements are exact at the nodes
    assert body.u.x.array[::3] == pytest.approx(exact, abs=1e-12 * size)


@pytest.mark.one_debian
@pytest.mark.parametrize("strain", [0.3, 1e-4, 1e-12])
@pytest.mark.parametrize("nu", [0.3, 0.4999])
def test_rounding_is_bounded(comm: Any, nu: float, strain: float) -> None:
    """The bound is above what one rounding of each unknown changes, and not far above."""
    body = Press(unit_cube(comm, 3))
    material = fem_snh.material("stable_neo_hookean", E=1.0, nu=nu)
    p = define(body.u, {material: ufl.dx}).problem()
    random = np.random.default_rng(0)
    p.x.array[:] = random.normal(size=p.x.getLocalSize()) * strain / 3
    p.jacobian(p.x, "exact")
    r, s = p.x.duplicate(), p.x.duplicate()
    p.residual(p.x, r)
    bound = p.rounding_force(p.x)
    assert p.rounding_force(p.x, least=1e20 * bound) == 0
    p.x.array[:] *= 1 + 2.0**-52 * random.choice([-1, 0, 1], size=p.x.getLocalSize())
    p.residual(p.x, s)
    s.axpy(-1.0, r)
    assert s.norm() < bound < 300 * s.norm()


def fall(E: float, integrator: str, cells: int = 3, **keys: Any) -> list[dict[str, Any]]:
    """Return the rows of 20 steps of free fall: a cube of 1 mm, E in MPa, density of steel."""
    scene = {
        "name": "fall", "mesh": {"source": "cube"}, "cells": cells, "element": "Q1",
        "material": {"name": "stable_neo_hookean", "E": E, "nu": 0.3, "density": 7.8e-9},
        "gravity": {"vector": [0, 0, -9810]},
        "time": {"duration": 0.01, "steps": 20, "integrator": integrator},
        "probe": [{"name": "top", "point": [0.5, 0.5, 1]}],
    }  # fmt: skip
    return solve(Scene.model_validate(scene | keys)).steps


def fallen(integrator: str, n: int = 20, h: float = 5e-4, g: float = 9810) -> float:
    """Return the fall in n steps of size h, by the integrator's own formula for a point mass."""
    if integrator == "newmark":
        return -g * (n * h) ** 2 / 2
    if integrator == "backward_euler":
        return -g * h**2 * n * (n + 1) / 2
    x, v = [0.0, -g * h**2], [0.0, -g * h]  # BDF2, after a step of backward Euler
    for _ in range(n - 1):
        v = [v[1], (4 * v[1] - v[0] - 2 * h * g) / 3]
        x = [x[1], (4 * x[1] - x[0] + 2 * h * v[1]) / 3]
    return x[1]


@pytest.mark.parametrize("integrator", ["newmark", "backward_euler", "bdf2"])
@pytest.mark.parametrize("E", [1.0, 2e5])
def test_a_stiff_body_falls(E: float, integrator: str) -> None:
    """Weight and inertia of steel are 4e-10 of E V^(2/3); the fall does not depend on E."""
    rows = fall(E, integrator)
    assert all(row["converged"] and row["newton"] for row in rows)
    assert rows[-1]["probes"]["top"][2] == pytest.approx(fallen(integrator), rel=1e-4)


@pytest.mark.mpi
@pytest.mark.parametrize("cells", [4, 6])
def test_free_fall_of_a_stiff_body_is_a_linear_problem(cells: int) -> None:
    """Rigid motions are 4e-8 of the stiffness, which single precision alone would lose."""
    rows = fall(2e5, "newmark", cells=cells)
    assert sum(row["newton"] for row in rows) <= 25
    assert sum(row["linear"] for row in rows) <= 100
    assert rows[-1]["probes"]["top"][2] == pytest.approx(fallen("newmark"), rel=1e-7)


def test_a_small_force_beside_large_ones_moves_a_body_in_time() -> None:
    """Pulled by 1e5 times its weight, a stiff cube still falls as fast as without the pull."""
    pull = [
        {"group": group, "vector": [sign * 1e5 * 7.8e-9 * 9810, 0, 0]}
        for group, sign in (("left", -1), ("right", 1))
    ]
    rows = fall(2e5, "backward_euler", traction=pull)
    assert rows[-1]["probes"]["top"][2] == pytest.approx(fallen("backward_euler"), rel=1e-3)


@pytest.mark.parametrize(
    ("element", "nu"), [("Q1", 0.3), ("Q1P0", 0.4999), ("P2", 0.4999), ("Q2Q1", 0.4999)]
)
def test_small_loads_are_proportional(element: str, nu: float) -> None:
    """A steel cube under 2 mPa to 200 kPa of shear: Hooke's response, the reaction is the load."""
    found = {}
    for load in (2e5, 2e-3):
        scene = {
            "name": "sheared", "mesh": {"source": "cube"}, "cells": 2, "element": element,
            "material": {"name": "stable_neo_hookean", "E": 2e11, "nu": nu},
            "hold": [{"group": "bottom"}], "reactions": ["bottom"],
            "traction": [{"group": "top", "vector": [load, 0, 0]}],
            "probe": [{"name": "tip", "point": [1, 1, 1]}],
        }  # fmt: skip
        row = solve(Scene.model_validate(scene)).steps[-1]
        assert row["converged"]
        assert row["reactions"]["bottom"][0] == pytest.approx(-load, rel=1e-3)
        found[load] = row["probes"]["tip"][0] / load
    assert found[2e-3] == pytest.approx(found[2e5], rel=1e-3)


@pytest.mark.parametrize("option", ["snes_atol", "snes_rtol"])
def test_a_given_tolerance_is_met(option: str) -> None:
    """A tighter one than the default, and one that rounding does not permit."""
    default = loaded(1.0, 0.1).steps[0]
    tight = loaded(1.0, 0.1, petsc={option: 1e-12}).steps[0]
    assert tight["residual"] <= tight["tolerance"] <= 1e-12 < default["residual"]
    least = loaded(1.0, 0.1, petsc={option: 1e-30}).steps[0]
    assert least["converged"] and least["residual"] <= least["tolerance"] < 1e-14
