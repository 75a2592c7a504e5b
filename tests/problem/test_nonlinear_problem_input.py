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
            "missing key 'kinematics': expected one of plane_strain, plane_stress, axisymmetric, "
            "axisymmetric_torsion, as the mesh has 2 dimensions",
        ),
        (fem.Function(cubic), "of degree 1 or 2 with 3 components"),
        (fem.Function(plane), "of degree 1 or 2 with 3 components"),
    ):
        assert expected in message(u, {SNH: ufl.dx})


def test_materials(body):
    dx = ufl.Measure("dx", body.domain, subdomain_data=halves(body.domain))
    other = ufl.Measure("dx", unit_cube(body.domain.comm, 1))
    two, three = (dx(metadata={"quadrature_degree": n}) for n in (2, 3))
    surface = "expected {fem_snh.material(...): a measure dx of cells}"
    for materials, expected in (
        ({SNH: dx(1)}, "4 of 8 cells are in none of the groups 'dx(1)': expected one for each"),
        ({SNH: dx, SOFT: dx(2)}, "expected a group that shares no cell with 'dx(everywhere)'"),
        ({SNH: ufl.dx(1)}, "dx(1)': expected a measure with subdomain_data"),
        ({SNH: other}, "'a measure on another mesh': expected the mesh of the displacement"),
        ({SNH: ufl.ds}, surface),
        ({"stable_neo_hookean": ufl.dx}, surface),
        ({SNH: two(1), SOFT: three(2)}, "'quadrature degrees 2, 3': expected the same"),
        ({}, "materials = {}: expected a material, or a term that is not linear in u"),
        ({SNH: dx, SOFT: dx(9)}, "[stable_neo_hookean] = 'dx(9)': expected a measure of cells"),
        (None, "materials = None: expected {fem_snh.material(...): a measure dx of cells}"),
        ([SNH], "expected {fem_snh.material(...): a measure dx of cells}"),
    ):
        assert expected in message(body.u, materials)
    facets = mesh.meshtags(body.domain, 2, np.array([0], np.int32), np.array([1], np.int32))
    wrong = ufl.Measure("dx", body.domain, subdomain_data=facets)(1)
    assert "expected meshtags of cells" in message(body.u, {SNH: wrong})


def tagged_top(body):
    """A measure of the boundary, whose top has the tag 1; of several ranks not all have a part."""
    top = mesh.locate_entities_boundary(body.domain, 2, lambda x: np.isclose(x[2], 1.0))
    inside = mesh.locate_entities(body.domain, 2, lambda x: np.isclose(x[2], 0.5))
    facets, first = np.unique(np.concatenate([top, inside]), return_index=True)
    values = np.where(first < len(top), 1, 5).astype(np.int32)
    tags = mesh.meshtags(body.domain, 2, facets, values)
    return ufl.Measure("ds", body.domain, subdomain_data=tags)


def test_measures_of_nothing(body):
    """Each integral of a form has a facet, or a cell, on one of the ranks at least."""
    ds, dx = tagged_top(body), ufl.Measure("dx", body.domain, subdomain_data=halves(body.domain))
    work, v = body.u[2], ufl.TestFunction(body.V)[2]
    nothing = "expected an integral over facets of the boundary; none has the tag "
    for form, expected in (
        (work * ds(8), f"terms[0] = 'ds(8)': {nothing}8"),
        (v * ds(8), f"terms[0] = 'ds(8)': {nothing}8"),
        (work * ds(1) + work * ds(8), f"terms[0] = 'ds(8)': {nothing}8"),
        (work * ds((1, 8)), f"terms[0] = 'ds(8)': {nothing}8"),
        (work * ds(5), f"terms[0] = 'ds(5)': {nothing}5"),  # tagged, but inside of the body
        (work * dx(3), "terms[0] = 'dx(3)': expected an integral over cells; none has the tag 3"),
        (work * ufl.ds(1), "terms[0] = 'ds(1)': expected a measure with subdomain_data"),
    ):
        assert expected in message(body.u, {SNH: ufl.dx}, terms=[form])
    nodes = np.empty(0, np.int32)
    empty = fem.dirichletbc(np.zeros(3), nodes, body.V)
    expected = "bcs[1] = 'a condition on no dof': expected a condition on at least one node"
    assert expected in message(body.u, {SNH: ufl.dx}, bcs=[body.bcs[0], empty])
    pull = fem_snh.Traction(group=ds(1), vector=[0, 0, 1])
    assert "expected a condition made by" in message(body.u, {SNH: ufl.dx}, bcs=[pull])


def test_residuals_of_the_other_sign(body):
    """Newton's method for equations takes either; one that minimises would go to infinity."""
    strain = ufl.sym(ufl.grad(body.u))
    energy = (ufl.inner(strain, strain) + 10 * ufl.tr(strain) ** 4) * ufl.dx
    residual = ufl.derivative(energy, body.u, ufl.TestFunction(body.V))
    dead = body.u[2] * ufl.ds
    found = message(body.u, {}, bcs=body.bcs, terms=[-residual, dead])
    assert "terms = 'forms of the other sign'" in found and "multiply the forms by -1" in found
    problem = fem_snh.NonlinearProblem(body.u, {}, bcs=body.bcs, terms=[residual, dead])
    problem.solve()
    assert problem.reason.startswith("CONVERGED")


def test_an_element_that_treats_nothing(body):
    """Q1P0 treats volume terms of materials; a program with forms alone is told so."""
    strain = ufl.sym(ufl.grad(body.u))
    terms = [(ufl.inner(strain, strain) + 100 * ufl.tr(strain) ** 2) * ufl.dx]
    for element, noted in (("Q1P0", True), ("Q1", False)):
        problem = fem_snh.NonlinearProblem(body.u, {}, bcs=body.bcs, terms=terms, element=element)
        problem.solve()
        texts = [note.text for note in problem.notes if note.kind == "locking"]
        assert any("'Q1P0' has no effect without a material" in t for t in texts) == noted


def test_measures_of_part_of_the_ranks(body):
    """The tops of all ranks together give the resultant force, 1 per unit of the top."""
    ds = tagged_top(body)
    load = fem.Constant(body.domain, 1e-6)
    problem = fem_snh.NonlinearProblem(
        body.u, {SNH: ufl.dx}, bcs=body.bcs[:1], terms=[-load * body.u[2] * ds(1)]
    )
    problem.solve()
    assert problem.solver.getConvergedReason() > 0
    mean = fem.assemble_scalar(fem.form(body.u[2] * ds(1)))
    assert 1e-7 < body.domain.comm.allreduce(mean) < 1e-5  # about load / E


def test_quadrature(body):
    """A rule that materials would ignore is refused, as is a degree with hourglass modes."""
    for metadata, expected in (
        ({"quadrature_degree": 1}, "quadrature = 1: expected a whole number from 2 to 30 with Q1"),
        ({"quadrature_degree": True}, "quadrature_degree = True: expected a whole number"),
        ({"quadrature_degree": "x"}, "quadrature_degree = 'x': expected a whole number"),
        ({"quadrature_degree": [3]}, "quadrature_degree = [3]: expected a whole number"),
        ({"quadrature_rule": "vertex"}, "metadata['quadrature_rule'] = 'vertex': expected 'def"),
        ({"quadratur_degree": 3}, "unknown materials[stable_neo_hookean].metadata key"),
    ):
        assert expected in message(body.u, {SNH: ufl.dx(metadata=metadata)})
    default = ufl.dx(metadata={"quadrature_rule": "default", "quadrature_degree": np.int64(4)})
    assert fem_snh.NonlinearProblem(body.u, {SNH: default}, bcs=body.bcs)


def test_forms_that_do_not_compile(body):
    """Mistakes that UFL finds, FFCx when it generates code, and its C compiler."""
    u, v = body.u, ufl.TestFunction(body.V)
    dx = ufl.dx(body.domain)
    good = ufl.inner(u, u) * ufl.dx
    for form in (
        ufl.FacetNormal(body.domain)[0] * u[0] * dx,
        ufl.inner(v, v) * dx,
        ufl.bessel_I(1, u[0]) * dx,
        float("inf") * good,
    ):
        found = message(u, {SNH: ufl.dx}, terms=[good, form])
        assert found.startswith("terms[1] = a form: expected one that UFL and FFCx compile: ")
        assert len(found) < 250
