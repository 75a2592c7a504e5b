"""The skin of a lattice: its surface, the cells that carry it, and its displacement."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import create_problem, set_values

from fem_snh import _dolfinx
from fem_snh.assembly.elements import ELEMENTS
from fem_snh.assembly.unknowns import local_values
from fem_snh.contact.gathered_surface import embedded_surface
from fem_snh.geometry.shapes import Box, Capsule, Sphere, Union
from fem_snh.geometry.shapes.closed_surface import check_closed
from fem_snh.kernels.material import material
from fem_snh.mesh import lattice

COMM = MPI.COMM_WORLD
BALL = Sphere((0.1, 0.2, 0.3), 0.5)
#: Two rods, half a cell apart, that a palm joins.
CELL = 0.1
FINGERS = Union(
    (
        Box((0.4, 0.075, 0.0), (1.2, 0.1, 0.1)),
        Box((0.4, -0.075, 0.0), (1.2, 0.1, 0.1)),
        Box((-0.1, 0, 0), (0.2, 0.25, 0.1)),
    )
)


def local(data, cell):
    """Return the coordinates of the skin's points within their cells, in cells."""
    return (data.skin.points - data.x[data.cells[data.skin.cells, 0]]) / cell


@pytest.mark.one_debian
@pytest.mark.parametrize("divisions", [2, 3])
@pytest.mark.parametrize(
    "shape, cell", [(BALL, 0.13), (Capsule((0, 0, 0), (0.5, 0.6, 0.7), 0.2), 0.11), (FINGERS, CELL)]
)
def test_the_skin_is_closed_on_the_shape_and_in_its_cells(shape, cell, divisions):
    data = lattice.lattice(shape, cell, divisions=divisions)
    skin = data.skin
    check_closed(skin.points, skin.triangles.astype(np.int64), "skin")
    edges = np.unique(np.sort(skin.triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    assert len(skin.points) - len(edges) + len(skin.triangles) == 2  # Euler: one sphere
    if shape is not FINGERS:
        distance = np.abs(shape.distance(skin.points))
        assert np.median(distance) < 1e-12
        assert distance.max() < 0.02 * cell  # points that stay in their cubes
    xi = local(data, cell)
    assert xi.min() > -0.011 and xi.max() < 1.011
    assert data.fractions.min() >= 1e-3


@pytest.mark.one_debian
@pytest.mark.mpi
@pytest.mark.parametrize("name", [e.name for e in ELEMENTS.values() if e.cell == "hexahedron"])
@pytest.mark.parametrize("shape", [BALL, FINGERS], ids=["ball", "fingers"])
def test_the_skin_moves_with_its_cells(name, shape):
    """A field that the element represents is interpolated exactly, on any number of ranks."""
    body = lattice.create(COMM, lambda: shape, CELL)
    p = create_problem(body, ELEMENTS[name], material("stable_neo_hookean", 1.0, 0.3))
    surface = embedded_surface(p.V, body.skin)
    A = np.random.default_rng(3).normal(size=(3, 3))

    def field(x):
        bubble = (x[:, [1]] * x[:, [2]]) ** (ELEMENTS[name].degree - 1) * x[:, [0]]
        return x @ A.T + bubble

    u = set_values(p, field, _dolfinx.create_vector(p.V))
    displacement = local_values(u).reshape(-1, 3)
    expected = body.skin.points + field(body.skin.points)
    assert np.abs(surface.positions(displacement) - expected).max() < 1e-12
    assert np.allclose(surface.weights.sum(axis=1), 1, atol=1e-12)
    assert np.array_equal(surface.triangles, body.skin.triangles)
