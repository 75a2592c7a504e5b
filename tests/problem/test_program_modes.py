"""Frequencies of a dolfinx program and their errors: a scene's, a beam's, waves, mistakes."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from bodies import PRESS
from dolfinx import fem
from dolfinx_programs import Press, converged, halves, unit_cube
from running import solve

import fem_snh
from fem_snh import material
from fem_snh.scenes import Modes

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
    update = {"material": chosen, "move": move, "modes": Modes(count=4, density=2.0)}
    of_scene = solve(PRESS.model_copy(update=update), comm)
    body = Press(of_scene.problem.domain, height=height)
    problem = solved(body.u, {SNH: ufl.dx}, bcs=body.bcs)
    modes = problem.vibration_modes(4, density=2.0)
    rounding = 1e-5 if height else 1e-9
    assert modes.frequencies == pytest.approx(of_scene.frequencies, rel=rounding)
    assert (modes.density, modes.mass) == pytest.approx((2.0, 2.0), rel=1e-12)


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
