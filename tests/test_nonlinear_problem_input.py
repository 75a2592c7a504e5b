"""`fem_snh.NonlinearProblem` with wrong input: one line on every rank."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from dolfinx import fem, mesh
from dolfinx_programs import Press, halves, unit_cube, vector_space

import fem_snh

pytestmark = pytest.mark.mpi

SNH = fem_snh.material("stable_neo_hookean", E=1.0, nu=0.49)
SOFT = fem_snh.material("stable_neo_hookean", E=0.1, nu=0.49)


@pytest.fixture(scope="module")
def body(comm):
    return Press(unit_cube(comm, 2))


def message(*arguments, **keywords):
    with pytest.raises(fem_snh.BadInput) as error:
        fem_snh.NonlinearProblem(*arguments, **keywords)
    assert "\n" not in str(error.value)
    return str(error.value)


def test_displacements(comm, body):
    square = mesh.create_unit_square(comm, 2, 2)
    cubic, plane = vector_space(body.domain, 3), vector_space(body.domain, components=2)
    for u, expected in (
        (None, "u = None: expected a dolfinx Function, the displacement"),
        (
            fem.Function(vector_space(square, components=2)),
            "u.function_space.mesh = 'triangle cells in 2 dimensions': "
            "expected hexahedron or tetrahedron cells in 3",
        ),
        (fem.Function(cubic), "of degree 1 or 2 with 3 components"),
        (fem.Function(plane), "of degree 1 or 2 with 3 components"),
    ):
        assert expected in message(u, {SNH: ufl.dx})


def test_complex_numbers(body):
    """As all functions are if PETSc is configured with complex numbers."""
    expected = "u.x.array.dtype = 'complex128': expected float64 (a PETSc configured with real"
    assert expected in message(fem.Function(body.V, dtype=np.complex128), {SNH: ufl.dx})


def test_materials(body):
    dx = ufl.Measure("dx", body.domain, subdomain_data=halves(body.domain))
    other = ufl.Measure("dx", unit_cube(body.domain.comm, 1))
    two, three = (dx(metadata={"quadrature_degree": n}) for n in (2, 3))
    surface = "expected {fem_snh.material(...): a measure dx of cells}"
    for materials, expected in (
        ({SNH: dx(1)}, "0 of 8 cells are in two regions and 4 in none"),
        ({SNH: dx, SOFT: dx(2)}, "4 of 8 cells are in two regions and 0 in none"),
        ({SNH: ufl.dx(1)}, "dx(1)': expected a measure with subdomain_data"),
        ({SNH: other}, "'a measure on another mesh': expected the mesh of the displacement"),
        ({SNH: ufl.ds}, surface),
        ({"stable_neo_hookean": ufl.dx}, surface),
        ({SNH: two(1), SOFT: three(2)}, "'quadrature degrees 2, 3': expected the same"),
        ({}, "materials = {}: expected a material, or a term that is not linear in u"),
    ):
        assert expected in message(body.u, materials)
    facets = mesh.meshtags(body.domain, 2, np.array([0], np.int32), np.array([1], np.int32))
    wrong = ufl.Measure("dx", body.domain, subdomain_data=facets)(1)
    assert "expected meshtags of cells" in message(body.u, {SNH: wrong})


def test_conditions(body):
    other = Press(unit_cube(body.domain.comm, 1))
    assert "bcs[1] = 'a condition on another space'" in message(
        body.u, {SNH: ufl.dx}, bcs=[body.bcs[0], other.bcs[0]]
    )
    assert "bcs[0] = 3: expected a condition made by dolfinx.fem.dirichletbc" in message(
        body.u, {SNH: ufl.dx}, bcs=[3]
    )


def test_terms(body):
    other = Press(unit_cube(body.domain.comm, 1))
    u, v, w = body.u, ufl.TestFunction(body.V), ufl.TrialFunction(body.V)
    for term, expected in (
        (ufl.inner(v, w) * ufl.dx, "terms[0] = 'a form of rank 2': expected an energy (rank 0)"),
        (other.u[0] * ufl.dx, "terms[0] = 'a form on another mesh'"),
        (u[0] ** 2, "terms[0] = "),
    ):
        assert expected in message(u, {SNH: ufl.dx}, terms=[term])


def test_choices(body):
    arguments = body.u, {SNH: ufl.dx}
    assert "element = 'P2': expected one of Q1, Q1P0, for" in message(*arguments, element="P2")
    assert "did you mean 'clamp'" in message(*arguments, hessian="clmp")
    assert "predictor = 'extrapolate': expected" in message(*arguments, predictor="extrapolate")
    options = {"snes_hessian": "positive"}
    assert "hessian = 'positive': expected" in message(*arguments, petsc_options=options)
