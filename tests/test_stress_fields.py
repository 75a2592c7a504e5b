"""Stresses and strains at quadrature points, cells and nodes, against exact states."""

from __future__ import annotations

import warnings

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Hold, cube
from element_theory import problem

from fem_snh import _dolfinx
from fem_snh.fem.elements import ELEMENTS
from fem_snh.fem.field_values import FieldValues
from fem_snh.fem.nodal_projection import NodalProjection
from fem_snh.fem.stress_fields import POINT_FIELDS
from fem_snh.kernels.pointwise import material
from fem_snh.output_fields import ON_REQUEST

mpi = pytest.mark.mpi
every = pytest.mark.parametrize("element", ELEMENTS)
E, NU = 2.0, 0.45
MU, LAM = E / 2 / (1 + NU), E * NU / (1 + NU) / (1 - 2 * NU)
#: Of U(J) = STIFFNESS/2 (J - 1)^2, by the element's volume treatment (materials/volume_split.py).
STIFFNESS = {
    volume: LAM - b * MU * LAM / (LAM + b * MU) for volume, b in {"mean": 4, "pressure": 2}.items()
}


def displaced(comm, element, displacement, pressure=None, **conditions):
    """A problem of the stable Neo-Hookean cube at a displacement and, if unknown, a pressure."""
    p = problem(cube(comm, ELEMENTS[element].cell, 2), element, NU, E=E, **conditions)
    owned = _dolfinx.num_nodes(p.V)[0]
    p.x.array[: 3 * owned] = displacement(p.coordinates).ravel()
    if p.saddle_point:
        dofs = p.saddle_point.pressure_dofs(p.x)
        dofs[:] = 1.0
        p.split(p.x)
        X = p.saddle_point.Q.tabulate_dof_coordinates()[: len(dofs)]
        dofs[:] = pressure(X) / p.saddle_point.pressure()[: len(dofs)]
    return p


def affine(F):
    return lambda X: X @ (F - np.eye(3)).T


def uniform(J, volume):
    """The pressure of a uniform state, U'(J)."""
    return lambda X: np.full(len(X), STIFFNESS.get(volume, 0.0) * (J - 1))


def evaluated(p, at="cells"):
    return FieldValues(p).evaluate(POINT_FIELDS, at)


def close(found, expected):
    found = np.asarray(found)
    expected = np.broadcast_to(expected, found.shape)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)


# --- uniform states, in closed form --------------------------------------------------------------


@every
def test_uniaxial_stretch(comm, element):
    """The free sides are free of stress: DESIGN's exact solution, with lambda + mu for lambda."""
    s = 1.6
    J = 1 + MU / (LAM + MU) * (1 - 1 / s)
    side = np.sqrt(J / s)
    pressure = uniform(J, ELEMENTS[element].volume)
    p = displaced(comm, element, affine(np.diag([side, s, side])), pressure)
    found = evaluated(p)
    P = MU * (s - J / s**2)
    sigma = P * s / J
    close(found["pk1_stress"], np.diag([0, P, 0]))
    close(found["cauchy_stress"], np.diag([0, sigma, 0]))
    close(found["von_mises"], sigma)
    close(found["hydrostatic_stress"], sigma / 3)
    close(found["principal_stresses"], [sigma, 0, 0])
    close(found["green_lagrange_strain"], np.diag([J / s - 1, s**2 - 1, J / s - 1]) / 2)
    close(found["principal_stretches"], [s, side, side])


@every
def test_simple_shear(comm, element):
    """J = 1, so that sigma = mu (F F^T - I) and the element's pressure is zero."""
    g = 0.9
    F = np.eye(3) + g * np.outer([1, 0, 0], [0, 1, 0])
    p = displaced(comm, element, affine(F), uniform(1.0, ELEMENTS[element].volume))
    found = evaluated(p)
    sigma = MU * np.array([[g * g, g, 0], [g, 0, 0], [0, 0, 0]])
    close(found["cauchy_stress"], sigma)
    close(found["pk1_stress"], sigma @ np.linalg.inv(F).T)
    close(found["von_mises"], MU * np.sqrt(g**4 + 3 * g**2))
    close(found["hydrostatic_stress"], MU * g * g / 3)
    root = np.sqrt(g * g + 4)
    close(found["principal_stresses"], [MU * g * (g + root) / 2, 0, MU * g * (g - root) / 2])
    close(found["green_lagrange_strain"], [[0, g / 2, 0], [g / 2, g * g / 2, 0], [0, 0, 0]])
    close(found["principal_stretches"], [(root + g) / 2, 1, (root - g) / 2])
    for name, values in evaluated(p, "nodes").items():  # a constant is projected exactly
        close(values, found[name][0])


# --- torsion: exact at the quadrature points -----------------------------------------------------

RATE = 0.7


def torsion(X):
    """x = (X - t Y Z, Y + t X Z, 1.2 Z): in every space but that of P1."""
    return np.column_stack([-X[:, 1], X[:, 0], np.zeros(len(X))]) * (RATE * X[:, 2:]) + (
        X * [0, 0, 0.2]
    )


def torsion_gradient(X):
    F = np.zeros((*X.shape, 3))
    F[...] = np.diag([1, 1, 1.2])
    F[..., 0, 1], F[..., 1, 0] = -RATE * X[..., 2], RATE * X[..., 2]
    F[..., 0, 2], F[..., 1, 2] = -RATE * X[..., 1], RATE * X[..., 0]
    return F


def quadrature_points(p):
    """(cells, points, 3); the cells are trilinear or linear, as their vertices are."""
    points, _ = _dolfinx.quadrature(p.element.cell, p.element.quadrature)
    vertices = _dolfinx.tabulate_values(_dolfinx.function_space(p.domain, 1), points)
    return vertices @ _dolfinx.geometry_x(p.domain)[_dolfinx.geometry_dofs(p.domain)]


def gradients(p):
    """F at the quadrature points; of P1, by the edges of the deformed and the undeformed cell."""
    if p.element.name != "P1":
        return torsion_gradient(quadrature_points(p))
    corners = _dolfinx.geometry_x(p.domain)[_dolfinx.geometry_dofs(p.domain)]
    moved = corners + torsion(corners.reshape(-1, 3)).reshape(corners.shape)
    edges, deformed = (np.swapaxes(x[:, 1:] - x[:, :1], 1, 2) for x in (corners, moved))
    return (deformed @ np.linalg.inv(edges))[:, None]


def slope(X):
    return 0.3 + X @ [0.2, -0.4, 0.1]


@mpi
@every
def test_torsion_at_the_quadrature_points(comm, element):
    """P is `Material.pk1` of the exact F, with the element's pressure in place of U'(J)."""
    p = displaced(comm, element, torsion, slope)
    F, volume = gradients(p), ELEMENTS[element].volume
    J = np.linalg.det(F)
    chosen = material("stable_neo_hookean", E=E, nu=NU, barrier=False)
    P = chosen.pk1(F)
    points = FieldValues(p)
    if volume != "pointwise":
        weights = points._stresses.evaluate(p.x).weights
        mean = (weights * J).sum(axis=1, keepdims=True) / weights.sum(axis=1, keepdims=True)
        pressure = slope(quadrature_points(p)) if volume == "pressure" else 0
        if volume == "mean":
            pressure = STIFFNESS[volume] * (mean - 1)
        cofactor = J[..., None, None] * np.swapaxes(np.linalg.inv(F), -1, -2)
        P = P + (pressure - STIFFNESS[volume] * (J - 1))[..., None, None] * cofactor
    sigma = P @ np.swapaxes(F, -1, -2) / J[..., None, None]
    deviator = sigma - np.trace(sigma, axis1=-2, axis2=-1)[..., None, None] * np.eye(3) / 3
    expected = {
        "pk1_stress": P,
        "cauchy_stress": sigma,
        "von_mises": np.sqrt(1.5 * (deviator**2).sum(axis=(-2, -1))),
        "hydrostatic_stress": np.trace(sigma, axis1=-2, axis2=-1) / 3,
        "principal_stresses": np.linalg.eigvalsh((sigma + np.swapaxes(sigma, -1, -2)) / 2)[
            ..., ::-1
        ],
        "green_lagrange_strain": (np.swapaxes(F, -1, -2) @ F - np.eye(3)) / 2,
        "principal_stretches": np.linalg.svd(F, compute_uv=False),
    }
    found, means = points.evaluate(POINT_FIELDS, "points"), points.evaluate(POINT_FIELDS)
    share = _dolfinx.quadrature(p.element.cell, p.element.quadrature)[1]
    share = share / share.sum()  # the cells of this cube are affine
    for name in POINT_FIELDS:
        close(found[name], expected[name])
        close(means[name], np.einsum("q,cq...->c...", share, expected[name]))


# --- nodes ---------------------------------------------------------------------------------------


@mpi
@pytest.mark.parametrize("element", ["Q1", "P2", "Q2"])
def test_a_linear_field_is_projected_exactly(comm, element):
    p = displaced(comm, element, np.zeros_like)
    state = FieldValues(p)._stresses.evaluate(p.x)
    X = quadrature_points(p)
    values = np.stack([slope(X), np.ones_like(X[..., 0]), X[..., 1]], axis=-1)
    nodes = p.V.tabulate_dof_coordinates()
    found = NodalProjection(p, state.weights).project(values)
    close(found, np.column_stack([slope(nodes), np.ones(len(nodes)), nodes[:, 1]]))


@mpi
@pytest.mark.parametrize("element", ["P2", "Q2Q1"])
def test_reaction_forces_add_up_to_those_of_the_groups(comm, element):
    hold = [Hold("bottom"), Hold("right", ("x",))]
    p = displaced(comm, element, torsion, slope, hold=hold, reactions=["bottom", "right"])
    force = FieldValues(p).evaluate(["reaction_force"])["reaction_force"]
    n = _dolfinx.num_nodes(p.V)[0]
    X, total = p.coordinates, p.reactions(p.x)
    bottom = np.isclose(X[:, 2], 0)
    assert comm.allreduce(force[:n][bottom].sum(axis=0)) == pytest.approx(
        total["bottom"], abs=1e-12
    )
    right = np.isclose(X[:, 0], 1)
    assert comm.allreduce(force[:n][right, 0].sum()) == pytest.approx(total["right"][0], abs=1e-12)
    assert abs(comm.allreduce(abs(force[:n]).sum())) > 1
    assert not force[:n][~(bottom | right)].any() and not force[:n][right & ~bottom, 1:].any()
    assert set(ON_REQUEST) == {*POINT_FIELDS, "reaction_force"}


# --- degenerate states ---------------------------------------------------------------------------


def test_an_inverted_and_a_flat_cell_are_reported_as_they_are():
    comm = MPI.COMM_SELF
    inverted = evaluated(displaced(comm, "Q1", affine(np.diag([2.0, 1, -0.5]))))
    close(inverted["principal_stretches"], [2, 1, -0.5])
    close(inverted["green_lagrange_strain"], np.diag([3, 0, -0.75]) / 2)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        flat = evaluated(displaced(comm, "Q1", affine(np.diag([1.0, 1, 0]))))
    assert np.isfinite(flat["pk1_stress"]).all() and not (flat["von_mises"] < 1e10).any()


def test_a_small_strain_is_accurate_to_its_own_digits():
    tiny = 1e-12 * np.array([[1.0, 2, 0], [0.5, -1, 3], [0, 1, 2]])
    found = evaluated(displaced(MPI.COMM_SELF, "Q1", affine(np.eye(3) + tiny)))
    expected = (tiny + tiny.T) / 2
    got = found["green_lagrange_strain"]
    assert abs(got - expected).max() < 1e-3 * 1e-12
