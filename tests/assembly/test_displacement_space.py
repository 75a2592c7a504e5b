"""Nodes numbered along the body: the same space as dolfinx's, with fewer linear iterations."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from running import solve

import fem_snh
from fem_snh import _dolfinx
from fem_snh.mesh import mesh
from fem_snh.problem import definition
from fem_snh.scenes import build

mpi = pytest.mark.mpi


@mpi
@pytest.mark.parametrize(
    "source, cell, degree",
    [
        ("cube", "hexahedron", 1),
        ("cylinder", "hexahedron", 2),
        ("bracket", "tetrahedron", 2),
        ("bracket", "tetrahedron", 3),
        ("cook", "quadrilateral", 2),
        ("cook", "triangle", 3),
    ],
)
def test_the_space_is_that_of_dolfinx(comm: Any, source: str, cell: str, degree: int) -> None:
    """Nodes, ghosts and integrals of a function that the element has."""
    domain = mesh.generate(comm, source, cell, cells=3).domain
    dim = domain.geometry.dim
    V = fem_snh.displacement_space(domain, degree)
    W = _dolfinx.function_space(domain, degree, (dim,))
    assert _dolfinx.num_nodes(V) == _dolfinx.num_nodes(W)
    assert _dolfinx.num_components(V) == dim
    owned = _dolfinx.num_nodes(V)[0]
    found, expected = (space.tabulate_dof_coordinates()[:owned] for space in (V, W))
    for a, b in zip(*(X[np.lexsort(np.round(X, 9).T)] for X in (found, expected)), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-12)

    def values(X: np.ndarray) -> np.ndarray:
        return np.stack([X[0] ** degree + k * X[1] for k in range(dim)])

    u, w = fem.Function(V), fem.Function(W)
    u.interpolate(values)
    w.interpolate(values)
    at_nodes = values(V.tabulate_dof_coordinates().T).T
    np.testing.assert_allclose(u.x.array.reshape(-1, dim), at_nodes, atol=1e-12)  # ghosts too
    u.x.array[owned * dim :] = np.nan
    u.x.scatter_forward()
    np.testing.assert_allclose(u.x.array.reshape(-1, dim), at_nodes, atol=1e-12)
    integrals = [
        comm.allreduce(fem.assemble_scalar(fem.form(ufl.inner(ufl.grad(f), ufl.grad(f)) * ufl.dx)))
        for f in (u, w)
    ]
    assert integrals[0] == pytest.approx(integrals[1], rel=1e-12)


def test_nodes_are_in_layers_across_the_longest_extent(comm: Any) -> None:
    """A cylinder along z: no node is a layer ahead of one with a higher number."""
    domain = mesh.generate(comm, "cylinder", "hexahedron", cells=6).domain
    X = fem_snh.displacement_space(domain).tabulate_dof_coordinates()
    axis = np.ptp(X, axis=0).argmax()
    planes = np.unique(np.round(X[:, axis], 9))
    assert len(planes) > 6
    assert (np.diff(X[:, axis]) >= -1e-9).all()


@pytest.mark.one_debian
@pytest.mark.parametrize("element, share", [("Q2", 0.85), ("P2", 0.95)])
def test_it_saves_linear_iterations(
    monkeypatch: pytest.MonkeyPatch, element: str, share: float
) -> None:
    """Per Newton iteration of a stretch, beside dolfinx's own order of the nodes."""
    given: dict[str, Any] = {"cells": 10, "steps": 1, "stretch": 1.2, "nu": 0.49}
    found = []
    for natural in (False, True):
        if natural:
            for module in (build, definition):
                monkeypatch.setattr(
                    module,
                    "space_for",
                    lambda domain, of, c: _dolfinx.function_space(domain, of.degree, (c,)),
                )
        (step,) = solve("stretch", element=element, **given).steps
        assert step["converged"]
        found.append(step["linear"] / step["newton"])
    assert found[0] < share * found[1], found
