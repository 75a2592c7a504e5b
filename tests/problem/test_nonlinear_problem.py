"""`fem_snh.NonlinearProblem`: a solve in a user's dolfinx program."""

from __future__ import annotations

from petsc4py import PETSc

import numpy as np
import pytest
import ufl
from derivatives import check_derivatives
from dolfinx import fem, mesh
from dolfinx_programs import Bar, Press, converged, halves, unit_cube, vector_space
from scipy.optimize import brentq

import fem_snh
from fem_snh.errors import BadInput

pytestmark = pytest.mark.mpi

SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)
TIGHT = {"snes_scaled_tol": 1e-11}


def difference(comm, a, b):
    """The largest difference of two functions, over the largest value. Collective."""
    largest = max(comm.allgather(abs(b).max(initial=0)))
    return max(comm.allgather(abs(a - b).max(initial=0))) / largest


@pytest.mark.one_debian
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


@pytest.mark.one_debian("ranks")
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


@pytest.mark.one_debian
def test_values_change_between_solves(comm):
    """A time loop: a component's boundary value and a load change; uniaxial stretch is exact."""
    bar = Bar(unit_cube(comm, 2))
    pressure = fem.Constant(bar.domain, 0.0)
    back = ufl.conditional(ufl.gt(ufl.SpatialCoordinate(bar.domain)[1], 0.99), 1, 0)
    problem = fem_snh.NonlinearProblem(
        bar.u, {SNH: ufl.dx}, bcs=bar.bcs, terms=[pressure * bar.u[1] * back * ufl.ds],
        petsc_options=TIGHT,
    )  # fmt: skip
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
    return brentq(lambda w: SNH.pk1(np.diag([s, w, w]))[1, 1], 0.3, 1.5, xtol=1e-13)


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


def test_steps_go_to_the_boundary_values_in_proportion(comm):
    """Heights of a press by 0.3 in three steps, and of one from the pressed state."""
    body = Press(unit_cube(comm, 2), height=-0.3)
    problem = fem_snh.NonlinearProblem(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    nodes, heights = body.dofs(2, 1.0), []
    for row in problem.steps(3):
        assert row["converged"]
        heights.append(body.u.x.array.reshape(-1, 3)[nodes, 2])
    for load, height in zip((1 / 3, 2 / 3, 1), heights, strict=True):
        np.testing.assert_allclose(height, -0.3 * load, rtol=1e-14)
    body.top.x.array[2::3] = 0.1
    pressed = body.u.x.array.copy()
    first = next(problem.steps(4))
    other = Press(unit_cube(comm, 2), height=0.1)
    other.u.x.array[:] = pressed
    fresh = fem_snh.NonlinearProblem(other.u, {SNH: ufl.dx}, bcs=other.bcs)
    expected = next(fresh.steps(4))
    assert first["load"] == 0.25
    for key in ("newton", "linear", "residual"):  # nothing of the first path is left
        assert first[key] == pytest.approx(expected[key], rel=1e-6)
    np.testing.assert_allclose(body.u.x.array.reshape(-1, 3)[nodes, 2], -0.2, rtol=1e-14)


@pytest.mark.filterwarnings("ignore::fem_snh.errors.ResultNote")
@pytest.mark.parametrize("ramped", [False, True])
def test_loads_in_ufl_that_are_not_ramped_are_no_jump(comm, ramped):
    """They act in full in the first step, which had the note of a snap-through."""
    corners = [np.zeros(3), np.array([4.0, 1.0, 1.0])]
    body = mesh.create_box(comm, corners, [4, 1, 1], mesh.CellType.hexahedron)
    V = vector_space(body, 2)
    dofs = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0))
    u, pull = fem.Function(V), fem.Constant(body, np.array([80.0, 0.0, 0.0]))
    m = fem_snh.material("stable_neo_hookean", E=100.0, nu=0.49)
    problem = fem_snh.NonlinearProblem(
        u, {m: ufl.dx}, bcs=[fem.dirichletbc(np.zeros(3), dofs, V)],
        terms=[-ufl.inner(pull, u) * ufl.ds],
    )  # fmt: skip

    def set_load(load):
        pull.value[0] = 80.0 * load

    rows = problem.steps(6, set_load if ramped else None)
    row = next(row for row in rows if row["converged"])
    assert "jump" not in row.get("notes", [])
    assert ["load" in [note.kind for note in problem.notes]] == [not ramped]


def test_steps_that_fail_are_halved_and_restored(comm):
    """With three Newton iterations a press by 60 % fails; its parts converge."""
    body = Press(unit_cube(comm, 2), height=-0.6)
    problem = fem_snh.NonlinearProblem(
        body.u, {SNH: ufl.dx}, bcs=body.bcs, petsc_options={"snes_max_it": 3}
    )
    before, rows = body.u.x.array.copy(), []
    for row in problem.steps(1):
        rows.append(row)
        if not rows[0]["converged"] and len(rows) == 1:
            np.testing.assert_array_equal(body.u.x.array, before)
    assert [row["load"] for row in rows][:2] == [1.0, 0.5]
    assert not rows[0]["converged"] and rows[-1]["converged"] and rows[-1]["load"] == 1
    with pytest.raises(BadInput, match="number = 0: expected a whole number from 1"):
        next(problem.steps(0))


@pytest.mark.parametrize("element", ["Q1P0", "Q1"])
def test_a_volume_energy_beside_a_form(comm, element):
    """The element treats it as the material's: the same state, and derivatives of the energy."""
    mu, lam = SNH.lame
    treated = element == "Q1P0"
    local = 4 * mu * lam / (lam + 4 * mu) if treated else 0.0  # fem_snh.materials.volume_split
    states = []
    for own in (False, True):
        body = Press(unit_cube(comm, 2))
        J, k = ufl.det(body.F), fem.Constant(body.domain, lam - local)
        form = mu / 2 * (ufl.inner(body.F, body.F) - 3) - mu * (J - 1)
        form += (mu + local) / 2 * (J - 1) ** 2
        terms = [form * ufl.dx(metadata={"quadrature_degree": 2})] if own else []
        volume = (lambda J, k=k: k / 2 * (J - 1) ** 2) if own else None
        problem = fem_snh.NonlinearProblem(
            body.u, {} if own else {SNH: ufl.dx}, bcs=body.bcs, terms=terms, element=element,
            petsc_options=TIGHT, volume=volume,
        )  # fmt: skip
        problem.solve()
        assert converged(problem)
        assert not [note for note in problem.notes if "no effect" in note.text]
        states.append((body.u.x.array.copy(), problem.row["energy"]))
    assert difference(comm, states[1][0], states[0][0]) < 1e-7
    assert states[1][1] == pytest.approx(states[0][1], rel=1e-9)
    if comm.size == 1:
        problem.x.array[:] *= 1.3
        check_derivatives(problem._problem, range(81), 1e-5, 1e-7, 1e-6, constrained=False)
