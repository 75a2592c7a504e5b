"""Frequencies of a dolfinx program and their errors: a scene's, a beam's, waves, mistakes."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from bodies import PRESS
from dolfinx import fem
from dolfinx_programs import Bar, Press, converged, halves, unit_cube
from running import solve

import fem_snh
from fem_snh import material
from fem_snh.errors import BadInput
from fem_snh.scenes import Accuracy, Modes

mpi = pytest.mark.mpi

SNH = material("stable_neo_hookean", E=1.0, nu=0.49)
#: mu = rho = 1; the speed of pressure waves is sqrt(3.5).
UNIT = material("stable_neo_hookean", E=2.6, nu=0.3)


def solved(u, materials, **arguments):
    problem = fem_snh.NonlinearProblem(u, materials, **arguments)
    problem.solve()
    assert converged(problem)
    return problem


def total(comm, form):
    """The integral over all ranks."""
    return comm.allreduce(fem.assemble_scalar(fem.form(form)))


@pytest.mark.one_debian("ranks")
@mpi
@pytest.mark.parametrize("height", [0.0, -0.5])
def test_a_program_has_the_frequencies_of_its_scene(comm, height):
    """At rest to rounding; about a loaded state to the tolerance of Newton's method."""
    chosen = PRESS.material.model_copy(update={"name": "stable_neo_hookean", "nu": 0.49})
    move = [PRESS.move[0].model_copy(update={"translate": (0, 0, height)})]
    wanted = Accuracy(goals=["frequency.1", "frequency.2", "frequency.4"])
    update = {"material": chosen, "move": move, "modes": Modes(count=4, density=2.0)}
    of_scene = solve(PRESS.model_copy(update=update | {"error": True, "accuracy": wanted}), comm)
    body = Press(of_scene.problem.domain, height=height)
    problem = solved(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    modes = problem.vibration_modes(4, density=2.0)
    rounding = 1e-5 if height else 1e-9
    assert modes.frequencies == pytest.approx(of_scene.frequencies, rel=rounding)
    assert (modes.density, modes.mass) == (2.0, pytest.approx(2.0))
    before = body.u.x.array.copy()
    found = problem.estimate_error([(modes, 1), (modes, 2), (modes, 4)])
    assert found.reason == "" and (body.u.x.array == before).all()
    assert found.goals.keys() == of_scene.goals.keys()
    for name, goal in found.goals.items():
        other = of_scene.goals[name]
        assert goal.value == pytest.approx(other["value"], rel=rounding)
        assert goal.error == pytest.approx(other["error"], rel=1e-2 if height else 1e-6)
        assert goal.corrected == goal.value + goal.error


def rollers(domain, degree=1):
    """A cube between six rollers."""
    body = Bar(domain, degree, pull=0.0)
    fixed = fem.Constant(domain, 0.0)
    body.bcs += [body.roller(fixed, axis, 1.0) for axis in (1, 2)]
    return body


@pytest.mark.one_debian
@mpi
def test_shapes_are_functions_whose_quotients_are_the_frequencies(comm):
    """Rayleigh's quotient in UFL: two materials of different densities, about a pressed state."""
    body, light = Press(unit_cube(comm, 4), height=-0.2), material("neo_hookean", E=1.0, nu=0.3)
    # The quadrature of Q1: two points in each direction.
    dx = ufl.dx(domain=body.domain, subdomain_data=halves(body.domain), degree=3)
    setup = {"bcs": body.bcs, "densities": {light: 4.0}}
    problem = solved(body.u, {light: dx(1), UNIT: dx(2)}, **setup)
    modes = problem.vibration_modes(3, density=1.0)
    energy = light.ufl(body.F) * dx(1) + UNIT.ufl(body.F) * dx(2)
    assert (modes.density, modes.mass) == (pytest.approx(2.5), pytest.approx(2.5))
    bottom = np.isclose(body.V.tabulate_dof_coordinates()[:, 2], 0).repeat(3)
    for frequency, shape in zip(modes.frequencies, modes.shapes, strict=True):
        force = ufl.derivative(energy, body.u, shape)
        stiffness = total(comm, ufl.derivative(force, body.u, shape))
        square = ufl.inner(shape, shape)
        inertia = total(comm, 4.0 * square * dx(1) + square * dx(2))
        assert inertia == pytest.approx(modes.mass, rel=1e-9)
        assert frequency == pytest.approx(np.sqrt(stiffness / inertia) / (2 * np.pi), rel=1e-6)
        assert not shape.x.array[bottom].any()


@mpi
def test_an_energy_in_ufl_has_the_frequencies_of_its_material(comm):
    """Of the same body at rest, and their errors."""
    found = []
    for in_ufl in (False, True):
        body = rollers(unit_cube(comm, 3))
        dx = ufl.dx(domain=body.domain, degree=5)
        materials, terms = {UNIT: dx}, []
        if in_ufl:
            materials, terms = {}, [UNIT.ufl(body.F) * dx]
        problem = solved(body.u, materials, bcs=body.bcs, terms=terms)
        modes = problem.vibration_modes(8, density=1.0)
        found.append((modes.frequencies, problem.estimate_error([(modes, 4)])))
    assert found[1][0] == pytest.approx(found[0][0], rel=1e-9)
    exact = 3**0.5 / 2
    for _, estimate in found:
        goal = estimate.goals["frequency.4"]
        assert abs(exact - goal.corrected) < abs(exact - goal.value) / 3


# --- mistakes ------------------------------------------------------------------------------------


@mpi
@pytest.mark.parametrize(
    ("count", "density", "message"),
    [
        (0, 1.0, "count = 0: expected a whole number from 1 to"),
        (2.0, 1.0, "count = 2.0: expected a whole number from 1 to"),
        (
            3,
            None,
            "density = None: expected a number > 0 [kg/m^3], or 'densities' of all",
        ),
        (3, 0.0, "density = 0.0: expected a number > 0"),
        (3, "water", "density = 'water': expected a number > 0"),
        (99, 1.0, "modes: count = 99: there are only 8 free degrees of freedom"),
    ],
)
def test_modes_that_are_refused(comm, count, density, message):
    body = Bar(unit_cube(comm, 1))
    problem = fem_snh.NonlinearProblem(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    problem.solve()
    with pytest.raises(BadInput) as refused:
        problem.vibration_modes(count, density)
    assert message in str(refused.value) and "\n" not in str(refused.value)


@mpi
def test_frequencies_that_are_no_goals(comm):
    body = Bar(unit_cube(comm, 2))
    problem = solved(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    modes = problem.vibration_modes(2, density=1.0)
    for goals, message in (
        ([(modes, 3)], "goals[0] number = 3: expected a whole number from 1 to 2"),
        ({"a": (modes, 0)}, "goals[a] number = 0: expected a whole number from 1 to 2"),
        ([modes, (modes, 1)], "goals = 'frequency.1': expected a different name for each goal"),
        (["frequency.1"], "goals[0] = 'frequency.1': expected a point"),
        (
            [(modes, 1), (problem.vibration_modes(2, density=1.0), 2)],
            "goals = 'frequencies of 2 calls': expected frequencies of one call of",
        ),
    ):
        with pytest.raises(BadInput) as refused:
            problem.estimate_error(goals)
        assert message in str(refused.value)
    body.pull.value = 0.6
    problem.solve()
    with pytest.raises(BadInput, match=r"goals\[0\] = 'modes of another state': expected those"):
        problem.estimate_error([modes])
