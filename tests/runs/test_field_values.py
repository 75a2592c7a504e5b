"""Stresses at nodes and of degenerate states; reaction forces."""

from __future__ import annotations

import warnings

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Hold
from stress_states import (
    NU,
    E,
    affine,
    close,
    displaced,
    evaluated,
    quadrature_points,
    slope,
    torsion,
    torsion_gradient,
)

from fem_snh import _dolfinx
from fem_snh.records.output_fields import ON_REQUEST
from fem_snh.runs.output.field_values import FieldValues
from fem_snh.runs.output.nodal_projection import NodalProjection
from fem_snh.runs.output.point_fields import POINT_FIELDS

mpi = pytest.mark.mpi

# --- nodes ---------------------------------------------------------------------------------------


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["Q1", pytest.param("P2", marks=mpi), "Q2"])
def test_a_linear_field_is_projected_exactly(comm, element):
    p = displaced(comm, element, np.zeros_like)
    state = FieldValues(p)._stresses.evaluate(p.x, ())
    X = quadrature_points(p)
    values = np.stack([slope(X), np.ones_like(X[..., 0]), X[..., 1]], axis=-1)
    nodes = p.V.tabulate_dof_coordinates()
    found = NodalProjection(p, state.weights).project({"f": values})["f"]
    close(found, np.column_stack([slope(nodes), np.ones(len(nodes)), nodes[:, 1]]))


@pytest.mark.parametrize("element", [pytest.param("P2", marks=mpi), "Q2"])
def test_principal_values_at_nodes_are_those_of_the_tensor_there(comm, element):
    """In pure bending the only stress is along the beam and changes sign across it."""
    curvature = 1e-6

    def bent(X):
        x, y, z = (X - 0.5).T
        columns = x * y, -(x**2 + NU * (y**2 - z**2)) / 2, -NU * y * z
        return curvature * np.column_stack(columns)

    p = displaced(comm, element, bent)
    found = evaluated(p, "nodes")
    along = E * curvature * (p.V.tabulate_dof_coordinates()[:, 1] - 0.5)
    none = np.zeros_like(along)
    expected = {
        "von_mises": abs(along),
        "principal_stresses": np.column_stack([along.clip(0), none, along.clip(None, 0)]),
        "hydrostatic_stress": along / 3,
    }
    for name, values in expected.items():
        np.testing.assert_allclose(found[name], values, rtol=0, atol=1e-5 * E * curvature)


@mpi
def test_principal_stretches_at_nodes_are_those_of_the_projected_gradient(comm):
    """F is linear in torsion, so its projection is exact: its singular values are not linear."""
    p = displaced(comm, "P2", torsion)
    F = torsion_gradient(p.V.tabulate_dof_coordinates())
    # With no other field, and with all of them.
    alone = FieldValues(p).evaluate(["principal_stretches"], "nodes")
    assert list(alone) == ["principal_stretches"]
    for found in (alone, evaluated(p, "nodes")):
        close(found["principal_stretches"], np.linalg.svd(F, compute_uv=False))


@mpi
@pytest.mark.parametrize("element", ["Q2Q1"])
def test_reaction_forces_add_up_to_those_of_the_groups(comm, element):
    hold = [Hold("bottom"), Hold("right", ("x",))]
    p = displaced(comm, element, torsion, slope, hold=hold, reactions=["bottom", "right"])
    force = FieldValues(p).evaluate(["reaction_force"])["reaction_force"]
    n = _dolfinx.num_nodes(p.V)[0]
    X, total = p.coordinates, p.reactions(p.x)
    bottom, right = np.isclose(X[:, 2], 0), np.isclose(X[:, 0], 1)
    # What both constrain counts for the last of them.
    counts = np.column_stack([bottom & ~right, bottom, bottom])
    assert comm.allreduce((force[:n] * counts).sum(axis=0)) == pytest.approx(
        total["bottom"], abs=1e-12
    )
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
