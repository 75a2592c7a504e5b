"""A cube in states whose stresses are known, for the tests of stresses and strains."""

from __future__ import annotations

import numpy as np
from bodies import cube
from element_theory import problem

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.runs.output.field_values import FieldValues
from fem_snh.runs.output.point_fields import POINT_FIELDS

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


#: The tangent of the angle by which `torsion` turns a section, per length.
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


def slope(X):
    return 0.3 + X @ [0.2, -0.4, 0.1]
