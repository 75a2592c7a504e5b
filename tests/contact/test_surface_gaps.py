"""Gaps between surfaces, their derivatives, and the search for the closest facet."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from bodies import dense, wave
from derivatives import differences
from two_bodies import TwoBlocks

from fem_snh.contact.triangle_search import ClosestFacets, measure_gaps

#: A displacement that bends the surfaces, in the height of a block.
BEND = 0.05
pytestmark = pytest.mark.mpi


def pressed(element: str, cells: tuple[int, int] = (1, 2)) -> tuple[TwoBlocks, Any]:
    """Return blocks with bent surfaces that penetrate each other, and their displacement."""
    two = TwoBlocks(MPI.COMM_WORLD, element, cells, stiffness=1.0, gap=-0.15, hold=[], shift=0.1)
    p = two.problem
    X = p.V.tabulate_dof_coordinates()
    p.u.x.array[:] = wave(BEND)(X).ravel()
    return two, p.split(p.x)[0]


def contact_hessian(two: TwoBlocks, u: Any, filter: str) -> np.ndarray:
    """Return the matrix of the contact alone, without its constant diagonal."""
    matrix = two.problem.matrix
    matrix.couple([two.contact.couplings(u)])
    with matrix.adding():
        two.contact.add_hessian(u, None, filter, matrix)
    found = dense(matrix.mat)
    first = matrix.mat.getOwnershipRange()[0]
    fixed = np.concatenate(matrix.mat.comm.tompi4py().allgather(matrix.constrained_dofs + first))
    found[fixed, fixed] = 0.0
    return found


@pytest.mark.one_debian
@pytest.mark.parametrize("element", ["Q1", "P1", "P2"])
def test_derivatives(element: str) -> None:
    """Central differences of the energy and of the forces, on surfaces that are not flat."""
    two, u = pressed(element)
    p = two.problem
    X = p.V.tabulate_dof_coordinates()[: len(u.array) // 3]
    direction = u.duplicate()
    direction.array[:] = wave(1.0, 0.7)(X).ravel()
    direction.array[p.constrained_dofs] = 0.0
    matrix = contact_hessian(two, u, "exact")
    slope, forces, change = differences(two.contact, p.V, u, direction, 1e-5)
    assert two.contact.energy(u) > 0 and slope == pytest.approx(forces.dot(direction), rel=1e-6)
    change.array[p.constrained_dofs] = 0.0
    whole = np.concatenate(p.comm.allgather(direction.array_r))
    first, last = p.A.getOwnershipRange()
    atol = 2e-6 * np.abs(matrix @ whole).max()
    np.testing.assert_allclose((matrix @ whole)[first:last], change.array, atol=atol)


@pytest.mark.one_debian("ranks")
def test_filtered_hessians_are_semidefinite() -> None:
    two, u = pressed("Q1")
    exact, clamp, absolute = (contact_hessian(two, u, f) for f in ("exact", "clamp", "abs"))
    for matrix in (exact, clamp, absolute):
        np.testing.assert_allclose(matrix, matrix.T, atol=1e-12 * np.abs(exact).max())
    scale = np.abs(exact).max()
    assert np.linalg.eigvalsh(exact)[0] < -1e-4 * scale
    for matrix in (clamp, absolute, clamp - exact, absolute - clamp):
        assert np.linalg.eigvalsh(matrix)[0] > -1e-12 * scale


@pytest.mark.one_debian("ranks")
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_closest_facet_against_samples(element: str) -> None:
    """No sample of the other surface is closer, on a mesh of uneven facets."""
    two, _ = pressed(element, (3, 2))
    surface = two.contact.surface
    side, own = surface.sides[0], two.contact.pairs[0]
    x = surface.X * [1.0, 1.7, 1.0] + 0.02 * np.sin(7 * surface.X[:, ::-1])
    second = slice(side.weights.size, None)
    points = own.points(x)[second] + np.array([0.0, 0.0, 0.25])
    found = ClosestFacets(surface.shape, side).find(x, points, own.normals(x)[second], 0.5)
    some = np.flatnonzero(found.facet >= 0)
    assert len(some) > 0.7 * len(points)
    gaps = measure_gaps(surface.shape, side, x, points[some], found.facet[some], found.start[some])
    t = np.linspace(0, 1, 25)
    grid = np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)
    grid = grid[surface.shape.outside(grid) <= 1e-12]
    samples = (surface.shape.evaluate(grid, 0)[0] @ x[side.nodes]).reshape(-1, 3)
    distances = np.linalg.norm(points[some, None] - samples[None], axis=2).min(axis=1)
    # Within a facet the closest point is between samples, which are 1/24 of its size apart.
    spacing = own.size[-1] / 12
    assert (np.abs(gaps.gap) < distances + 1e-12).all()
    np.testing.assert_allclose(np.abs(gaps.gap), distances, atol=spacing)
    inner = gaps.outside <= 0
    arm = points[some] - np.einsum("nk,nki->ni", gaps.values, x[side.nodes[found.facet[some]]])
    slopes = np.einsum("ni,nia->na", arm, gaps.tangents)
    assert inner.mean() > 0.9 and np.abs(slopes[inner]).max() < 1e-10
