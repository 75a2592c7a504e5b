"""Pressures that follow the surface: forces, energies where there are some, and exact states."""

from __future__ import annotations

import numpy as np
import pytest
import ufl
from bodies import FACES, MATERIALS, Hold, cube, free_components, problem, set_values, wave
from contact_problems import press
from derivatives import differences
from dolfinx import fem
from dolfinx import mesh as dolfinx_mesh
from dolfinx_programs import tagged_measure, vector_space
from scipy.optimize import brentq

import fem_snh
from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.unknowns import update_ghosts
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.terms.loads import Pressure

mpi = pytest.mark.mpi
#: Largest displacement of `strip` [m], by dolfinx's forms and Newton's method without a
#: globalization, in 20 steps.
TIP = 5.841246192


def on(group, value=1.0):
    return Pressure(group, value)


def roller(group, component):
    return Hold(group, (component,))


#: Three planes of symmetry, and a corner that removes the rigid motions alone.
SYMMETRIC = [roller("left", "x"), roller("front", "y"), roller("bottom", "z")]
AT_A_CORNER = [Hold("corner_000"), Hold("corner_100", ("y", "z")), Hold("corner_010", ("z",))]
CLOSED = [on(face) for face in FACES]


@pytest.mark.one_debian
@pytest.mark.parametrize(
    ("loads", "hold", "has_energy"),
    [
        (CLOSED, [], True),
        ([on(face, 2.0 + (face == "top")) for face in FACES], [], False),
        ([on("top")], [Hold("bottom")], False),
        ([on("top")], [Hold(g) for g in ("left", "right", "front", "back")], True),
        ([on("top")], [Hold("left"), roller("right", "x"), Hold("front"), Hold("back")], True),
        ([on("top")], [roller(g, "x") for g in ("left", "right")], False),
        ([on("top"), on("right"), on("back")], SYMMETRIC, True),
        ([on("top"), on("right"), on("back", 1.1)], SYMMETRIC, False),
    ],
)
def test_pressures_are_conservative_where_edges_are_closed_or_constrained(
    comm, loads, hold, has_energy
):
    p = problem(cube(comm, "hexahedron", 2, 0.03), "Q1", features=loads, hold=hold)
    assert p.has_energy == p.terms[1].has_energy == has_energy
    assert bool(p.terms[1].note) == (not has_energy)


def in_a_box(comm, element, at=0.0):
    """A cube that is pressed from above between four smooth walls, parallel by pairs."""
    body = cube(comm, ELEMENTS[element].cell, 2, 0.03)
    _dolfinx.geometry_x(body.domain)[:] += at
    hold = [roller(g, c) for g, c in zip(("left", "right", "front", "back"), "xxyy", strict=True)]
    return problem(body, element, features=[on("top", 3.0)], hold=hold)


@mpi
@pytest.mark.parametrize("at", [0.0, 1e3])
def test_energy_between_parallel_walls(comm, at):
    """It is the pressure times the volume below the top, which becomes an inclined plane."""
    p = in_a_box(comm, "Q1", at)
    p.set_load(1.0)
    set_values(p, lambda X: (X - at) @ np.array([[0, 0, 0.2], [0, 0, 0.3], [0, 0, 0.1]]))
    assert p.terms[1].energy(p.split(p.x)[0]) == pytest.approx(3 * 0.35, rel=1e-9)


def symmetric_shell(comm, element):
    body = mesh.generate(comm, "shell", ELEMENTS[element].cell, cells=2, layers=1, order=2)
    hold = [roller(f"{component} = 0", component) for component in "xyz"]
    return problem(body, element, features=[on("inner", 0.2)], hold=hold)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q2", "P2"])
@pytest.mark.parametrize("body", [symmetric_shell, in_a_box])
def test_derivatives_of_the_energy(comm, body, element):
    """On curved cells: the residual is the energy's slope, the Hessian is the residual's."""
    p = body(comm, element)
    p.set_load(0.7)
    free = free_components(p)
    set_values(p, lambda X: free * wave(0.2)(X))
    update_ghosts(p.x)
    d = set_values(p, lambda X: free * wave(1.0, 0.7)(X), p.x.duplicate())
    slope, forces, change = differences(p.terms[1], p.V, p.x, d, 1e-4)
    assert slope == pytest.approx(forces.dot(d), rel=1e-6)
    change.array[p.constrained_dofs] = 0.0
    with p.matrix.adding():
        p.terms[1].add_hessian(p.split(p.x)[0], None, "exact", p.matrix)
    Ad = p.A.createVecLeft()
    p.A.mult(d, Ad)
    Ad.axpy(-1.0, change)
    assert Ad.norm() < 1e-6 * change.norm()


@pytest.mark.one_debian
@pytest.mark.parametrize("name", MATERIALS)
@pytest.mark.parametrize("hold", [SYMMETRIC, AT_A_CORNER], ids=["symmetric", "free"])
def test_a_cube_under_pressure_is_compressed_uniformly(comm, name, hold):
    """F = s I with P = -p cof F: the patch test of a follower load, for each material."""
    value, faces = 0.3, FACES if hold is AT_A_CORNER else ("right", "back", "top")
    loads = [on(face, value) for face in faces]
    p = problem(cube(comm, "hexahedron", 2, 0.05), "Q1", name, features=loads, hold=hold)
    press(p, tolerance=1e-12)
    m = material(E=1.0, **MATERIALS[name])
    s = brentq(lambda s: m.pk1(s * np.eye(3))[0, 0] + value * s**2, 0.5, 1.0, xtol=1e-15)
    X = p.V.tabulate_dof_coordinates()
    np.testing.assert_allclose(p.x.array.reshape(-1, 3), (s - 1) * X, atol=1e-9)


def strip(comm, form):
    """A strip that is clamped at x = 0 under a pressure on its top, of a feature or of UFL."""
    size, kind = np.array([4.0, 1.0, 0.5]), dolfinx_mesh.CellType.hexahedron
    domain = dolfinx_mesh.create_box(comm, [np.zeros(3), size], [12, 2, 2], kind)
    V = vector_space(domain)
    u = fem.Function(V)
    ds = tagged_measure("ds", domain, [lambda x: np.isclose(x[2], 0.5)])(1)
    clamped = fem.locate_dofs_geometrical(V, lambda x: np.isclose(x[0], 0.0))
    m, p = fem_snh.material("stable_neo_hookean", E=1000.0, nu=0.3), fem.Constant(domain, 0.0)
    F, v = ufl.Identity(3) + ufl.grad(u), ufl.TestFunction(V)
    force = p * ufl.inner(ufl.cofac(F) * ufl.FacetNormal(domain), v) * ds
    bcs = [fem.dirichletbc(np.zeros(3), clamped, V)]
    terms = [force if form else fem_snh.Pressure(ds, p)]
    problem = fem_snh.NonlinearProblem(u, {m: ufl.dx}, bcs=bcs, terms=terms)

    def set_load(load):
        p.value = 6.0 * load if form else 6.0  # the feature's amplitude is the load

    return problem, u, list(problem.steps(10, set_load))


@mpi
@pytest.mark.parametrize("form", [False, True])
def test_a_free_edge_has_the_whole_derivative(comm, form):
    """Newton's method is quadratic at a large rotation; with the symmetric part it is linear."""
    problem, u, found = strip(comm, form)
    assert all(row["converged"] for row in found)
    assert sum(row["newton"] for row in found) < 75  # 221 with the symmetric part
    assert found[-1]["newton"] <= 7 and found[-1]["clamped"] == 0
    # Near the solution each iteration squares the residual.
    u.x.array[:] *= 1 + 1e-4
    problem.solve()
    assert 1 <= problem.newton <= 4
    tip = comm.allreduce(float(abs(u.x.array).max()), max)
    assert tip == pytest.approx(TIP, rel=1e-5)
