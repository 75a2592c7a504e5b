"""Quadrilaterals and hexahedra that become simplices: volumes, faces, groups, curved cells."""

from __future__ import annotations

from itertools import combinations
from math import pi

from mpi4py import MPI

import numpy as np
import pytest

from fem_snh import _dolfinx
from fem_snh.errors import BadInput
from fem_snh.mesh import mesh as meshes
from fem_snh.mesh.bisection import simplex_volumes
from fem_snh.mesh.simplices import in_simplices

pytestmark = pytest.mark.one_debian


def gathered(source, cell="hexahedron", shake=0.0, **parameters):
    """The mesh of a built-in geometry; its inner nodes are moved by parts of a cell's size."""
    data = meshes.gather(meshes.generate(MPI.COMM_SELF, source, cell, **parameters))
    if shake:
        low, high = data.x.min(axis=0), data.x.max(axis=0)
        inside = ((data.x > low + 1e-9) & (data.x < high - 1e-9)).all(axis=1)
        moved = np.random.default_rng(1).uniform(-shake, shake, data.x.shape)
        data.x[inside] += moved[inside]
    return data


def facets(cells):
    """The facets of simplices, with sorted vertices, and in how many cells each is."""
    size = cells.shape[1] - 1
    every = np.concatenate([cells[:, c] for c in combinations(range(size + 1), size)])
    return np.unique(np.sort(every, axis=1), axis=0, return_counts=True)


@pytest.mark.parametrize(
    ("source", "cell", "shake"),
    [("cube", "hexahedron", 0.0), ("cube", "hexahedron", 0.04), ("cook", "quadrilateral", 0.0)],
)
def test_the_body_is_filled_without_hanging_nodes(source, cell, shake):
    """Each facet is in two cells, or in one and in a group of the surface."""
    data = gathered(source, cell, shake, cells=4)
    made, roots = in_simplices(data)
    dim = data.x.shape[1]
    assert (np.bincount(roots, minlength=len(data.cells)) == (2 if dim == 2 else 6)).all()
    volume = 1.0 if dim == 3 else 48 * (44 + 16) / 2
    assert simplex_volumes(made.x[made.cells]).sum() == pytest.approx(volume, rel=1e-12)
    found, counts = facets(made.cells)
    assert counts.max() == 2
    surface = {tuple(facet) for facet in found[counts == 1].tolist()}
    groups = [g for g in made.groups if g.dim == dim - 1]
    in_groups = {tuple(sorted(f)) for g in groups for f in g.entities.tolist()}
    assert in_groups <= surface and len(in_groups) == sum(len(g.entities) for g in groups)
    parts = 2 if dim == 3 else 1
    assert [len(g.entities) for g in groups] == [
        parts * len(g.entities) for g in data.groups if g.dim == dim - 1
    ]


def test_groups_are_where_they_were():
    """Points have their coordinates, cells the centres of the cells of which they are parts."""
    data = gathered("two_blocks", cells=2)
    made, roots = in_simplices(data)
    for before, after in zip(data.groups, made.groups, strict=True):
        if after.dim == 3:
            assert (
                np.isin(roots, before.entities) == np.isin(np.arange(len(roots)), after.entities)
            ).all()
        else:
            nodes = (data.x[np.unique(before.entities)], made.x[np.unique(after.entities)])
            assert nodes[0] == pytest.approx(nodes[1], abs=0)


@pytest.mark.parametrize("order", [1, 2])
def test_curved_cells_stay_on_round_faces(order):
    data = gathered("cylinder", cells=6, order=order)
    made, _ = in_simplices(data)
    assert made.degree == order and made.cells.shape[1] == (4, 10)[order - 1]
    mesh = meshes.distribute(MPI.COMM_SELF, "the mesh", lambda: made)
    volumes = meshes.cell_volumes(mesh.domain)
    same = meshes.distribute(MPI.COMM_SELF, "the mesh", lambda: data)
    exact = pi / 4 if order == 2 else meshes.cell_volumes(same.domain).sum()
    assert volumes.sum() == pytest.approx(exact, rel=(1e-12, 1e-3)[order - 1])
    radii = np.linalg.norm(made.x[:, :2], axis=1)
    assert radii.max() <= np.linalg.norm(data.x[:, :2], axis=1).max() + 1e-12
    assert _dolfinx.geometry_degree(mesh.domain) == order


@pytest.mark.parametrize(("source", "cell"), [("cube", "hexahedron"), ("cook", "quadrilateral")])
def test_cells_may_be_left_handed(source, cell):
    """As in files of gmsh whose surfaces have opposite loops: half of the cells are mirrored."""
    data = gathered(source, cell, cells=4)
    size = data.cells.shape[1]
    mirrored = np.arange(size) ^ 1  # the other direction along the first axis
    data.cells[::2] = data.cells[::2][:, mirrored]
    made, _ = in_simplices(data)
    _, counts = facets(made.cells)
    dim = data.x.shape[1]
    volume = 1.0 if dim == 3 else 48 * (44 + 16) / 2
    assert simplex_volumes(made.x[made.cells]).sum() == pytest.approx(volume, rel=1e-12)
    assert counts.max() == 2


def test_a_warped_hexahedron_is_refused():
    """Its face is folded so far that a tetrahedron is turned inside out."""
    data = gathered("cube", cells=1)
    data.x[data.cells.min()] += 1.2 * (0.5 - data.x[data.cells.min()]) * [2, 1, 1]
    with pytest.raises(BadInput, match=r"the hexahedron at \(.*\) is too warped to be divided"):
        in_simplices(data)
