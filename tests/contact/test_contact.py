"""Contact with obstacles: derivatives, filters, resultants and exact states."""

from __future__ import annotations

import numpy as np
import pytest
from bodies import Hold, cube, dense, set_values, wave
from contact_problems import contact_problem, plane, press, translation
from derivatives import differences
from two_bodies import ROLLERS

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.contact.obstacle_contact import RigidContact
from fem_snh.contact.obstacle_pair import NearFacets
from fem_snh.contact.surface_quadrature import SurfaceQuadrature
from fem_snh.errors import NotSettled
from fem_snh.geometry.motions import MovingShape
from fem_snh.geometry.shapes import Sphere
from fem_snh.mesh.mesh import volume
from fem_snh.terms.history import MAX_STALLED

mpi = pytest.mark.mpi
#: Each element; on several ranks one with a pressure and one without.
each_element = pytest.mark.parametrize(
    "element", [pytest.param("P1", marks=mpi), "Q1", "P2", "Q2", pytest.param("P2P1", marks=mpi)]
)
BALL = MovingShape(Sphere((0.4, 0.5, 1.45), 0.5), translation((0.05, -0.1, -0.1)))


def touched(comm, element, augmented):
    """A bent cube that a ball touches, with lagged friction and multipliers; its displacement."""
    body = cube(comm, ELEMENTS[element].cell, 2, 0.05)
    contacts = [RigidContact("ball", BALL, 0.3, augmented=augmented)]
    p, contact, _ = contact_problem(body, element, contacts)
    u = set_values(p, wave(0.02), _dolfinx.create_vector(p.V))
    p.set_load(0.2)
    contact.begin_step(u)
    p.set_load(0.7)
    assert not contact.update_lagged(u).settled
    return p, contact, set_values(p, wave(0.025, 0.1), u)


@pytest.mark.one_debian
@each_element
@pytest.mark.parametrize("augmented", [False, True], ids=["penalty", "augmented"])
def test_derivatives_and_filters(comm, element, augmented):
    """The residual is the energy's slope, the exact Hessian the residual's; others are positive."""
    p, contact, u = touched(comm, element, augmented)
    d = set_values(p, wave(1.0, 0.7), _dolfinx.create_vector(p.V))

    def product(filter):
        with p.matrix.adding():
            count = contact.add_hessian(u, None, filter, p.matrix)
        return comm.allreduce(count), dense(p.A)

    slope, forces, change = differences(contact, p.V, u, d, 1e-6)
    assert slope == pytest.approx(forces.dot(d), rel=1e-7)
    _, exact = product("exact")
    if not p.saddle_point:  # with a pressure, a matrix's rows of each rank are not those of u
        every = np.concatenate(comm.allgather(d.array_r))
        expected = np.concatenate(comm.allgather(change.array_r))
        assert np.linalg.norm(exact @ every - expected) < 1e-8 * np.linalg.norm(expected)
    assert np.linalg.eigvalsh(exact).min() < -1e-3
    clamped, absolute = product("clamp"), product("abs")
    assert clamped[0] == absolute[0] > 0
    for _, matrix in (clamped, absolute):
        assert np.linalg.eigvalsh(matrix).min() > -1e-14
    assert np.trace(absolute[1]) > np.trace(clamped[1]) > np.trace(exact)
    np.testing.assert_allclose((absolute[1] + exact) / 2, clamped[1], atol=1e-12)


@pytest.mark.one_debian("ranks")
@mpi
def test_facets_near_an_obstacle_are_all_that_touch(comm):
    body = cube(comm, "tetrahedron", 6, 0.03)
    V = _dolfinx.function_space(body.domain, 2, (3,))
    surface, X = SurfaceQuadrature(V), V.tabulate_dof_coordinates()
    searches = []

    def distance(x):
        searches.append(len(x))
        return BALL.evaluate(x, 0.5).distance

    near = NearFacets(surface, X, distance, lambda: BALL.pose(0.5))
    for size in np.linspace(0, 0.3, 20):
        u = wave(size)(X)
        x = surface.positions(u)
        deepest = BALL.evaluate(x.reshape(-1, 3), 0.5).distance.reshape(x.shape[:2]).min(axis=1)
        found = near.at(u)
        assert set(np.flatnonzero(deepest <= 0)) <= set(found)
        assert deepest[found].max(initial=0.0) < 0.6
    if len(surface):
        assert 1 < len(searches) < 15


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("augmented", [False, True], ids=["penalty", "augmented"])
def test_a_block_at_rest(comm, augmented):
    """The forces bear the weight; the penalty's penetration is that of springs."""
    k, rho, g, size = 50.0, 0.02, 9.81, 2.0
    body = cube(comm, "hexahedron", 3, size=size)
    floor = RigidContact("floor", plane((0, 0, -0.01)), 0.0, k, 1e-5, augmented)
    given = {"density": rho, "gravity": (0, 0, -g), "hold": ROLLERS[1:]}  # the sides
    p, _, _ = contact_problem(body, "Q1", [floor], E=100.0, nu=0.0, **given)
    step = press(p)
    row = step["obstacles"]["floor"]
    weight, area = rho * volume(body.domain) * g, size**2
    np.testing.assert_allclose(row["force"], [0, 0, weight], atol=1e-6 * weight)
    assert row["contacts"] == 9 * 4 and row["stiffness"] == pytest.approx(k)
    if augmented:
        assert 0 <= row["penetration"] <= 1e-5 and 1 < step["solves"] < 8
    else:
        assert row["penetration"] == pytest.approx(weight / (k * area), rel=1e-3)


@pytest.mark.one_debian
@each_element
@pytest.mark.parametrize("augmented", [False, True], ids=["penalty", "augmented"])
def test_a_cube_pressed_by_a_plane_is_deformed_uniformly(comm, element, augmented):
    """The patch test: an affine displacement, with the bulk and shear moduli of the two cubes."""
    K, G, d = 10.0, 0.25, 0.01
    E, nu = 9 * K * G / (3 * K + G), (3 * K - 2 * G) / (2 * (3 * K + G))
    top = plane((0, 0, 1), (0, 0, -1), translation((0, 0, -d)))
    contacts = [RigidContact("press", top, augmented=augmented)]
    body = cube(comm, ELEMENTS[element].cell, 2, 0.03)
    p, contact, _ = contact_problem(body, element, contacts, E=E, nu=nu, hold=ROLLERS)
    press(p)
    u = p.split(p.x)[0]
    nodes = u.array_r.reshape(-1, 3)
    X = p.V.tabulate_dof_coordinates()[: len(nodes)]
    slopes = [
        comm.allreduce(float(X[:, i] @ nodes[:, i])) / comm.allreduce(float(X[:, i] @ X[:, i]))
        for i in range(3)
    ]
    np.testing.assert_allclose(nodes, X * slopes, atol=1e-3 * d)
    assert slopes[0] == pytest.approx(-nu * slopes[2], rel=0.02)
    penetration = contact.record(u)["obstacles"]["press"]["penetration"]
    assert slopes[2] == pytest.approx(penetration - d, rel=1e-3)


@pytest.mark.one_debian
def test_multipliers_that_do_not_settle_fail_the_step(comm):
    """An obstacle that is pushed into constrained nodes cannot be left by them."""
    top = plane((0, 0, 1), (0, 0, -1), translation((0, 0, -0.1)))
    contacts = [RigidContact("press", top, 0, None, 1e-6, True)]
    hold = [*ROLLERS, Hold("top", ("z",))]
    p, *_ = contact_problem(cube(comm, "hexahedron", 1), "Q1", contacts, hold=hold)
    p.set_load(1.0)
    u = p.split(p.x)[0]
    p.history.begin_step(u)
    with pytest.raises(NotSettled, match=r"obstacle 'press': the gap is 1e\+05 times the tol"):
        while p.update_lagged():
            pass
    assert p.history.solves == 1 + MAX_STALLED
    p.set_load(0.0)
    with pytest.raises(AssertionError, match="DIVERGED_INNER: obstacle 'press': the gap is"):
        press(p)


@mpi
@pytest.mark.parametrize("element", ["P2", "Q1"])
def test_the_pressure_is_that_of_the_deformed_surface(comm, element):
    """Of a face that is 1.3 times as wide in x and 0.9 times in y; the nominal one is at rest."""
    floor = [RigidContact("floor", plane((0, 0, 0.01)), 0, 100.0)]
    p, contact, _ = contact_problem(cube(comm, ELEMENTS[element].cell, 4), element, floor)
    u = set_values(p, lambda X: X * [0.3, -0.1, 0], _dolfinx.create_vector(p.V))
    X = p.V.tabulate_dof_coordinates()
    inside = ((X[:, :2] > 0.3) & (X[:, :2] < 0.7)).all(axis=1) & (X[:, 2] == 0)
    for name, expected in (("nominal_contact_pressure", 1.0), ("contact_pressure", 1 / 1.17)):
        found = contact.nodal_field(name, u)
        np.testing.assert_allclose(found[inside], expected, rtol=1e-10)
