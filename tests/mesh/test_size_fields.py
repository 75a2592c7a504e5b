"""Meshes with a field of sizes, and what the sources of built-in bodies say of themselves."""

from __future__ import annotations

from itertools import combinations
from math import pi

from mpi4py import MPI

import numpy as np
import pytest
from bodies import volumes

import fem_snh
from fem_snh import scenes
from fem_snh.accuracy.refinement import Lineage, measured_rates, target_volumes, unmeasured
from fem_snh.mesh import gmsh_input
from fem_snh.mesh import mesh as meshes
from fem_snh.mesh.bisection import VertexSizes, bisect_times

mpi = pytest.mark.mpi
COMM = MPI.COMM_SELF


def field_of(data, factor):
    """The field with which each cell of a mesh has its volume times a factor."""
    dim = data.x.shape[1]
    mesh = meshes.distribute(COMM, "mesh", lambda: data)
    sizes = VertexSizes(data.cells[:, : dim + 1], data.x)
    before = meshes.cell_volumes(mesh.domain)
    wanted = factor * before
    if np.ptp(factor) < 1:  # as many cells as the volumes say, not their means at vertices
        wanted *= sizes.expected(wanted) / (before / wanted).sum()
    return sizes.field(wanted)


def ball(cells=3):
    return meshes.gather(meshes.generate(COMM, "ball", "tetrahedron", cells=cells, order=2))


def test_sizes_are_graded():
    """A single cell that is to be small has larger and larger neighbours."""
    data = ball(6)
    factor = np.ones(len(data.cells))
    factor[len(factor) // 2] = 1e-4
    found = field_of(data, factor)
    ratios = []
    for i, j in combinations(range(4), 2):
        length = np.linalg.norm(found.x[:, i] - found.x[:, j], axis=1)
        ratios.append(np.abs(found.sizes[:, i] - found.sizes[:, j]) / length)
    # The limit, times the factor that restores the expected number of cells.
    assert ratios[0].max() > 0 and np.max(ratios) < 0.35 * 1.05


@pytest.mark.parametrize("growth", [2.0, 8.0])
def test_a_body_is_meshed_again_with_as_many_cells_as_wanted(growth):
    """They are small where they are wanted small, on the exact surface, with their groups."""
    data = ball()
    centres = data.x[data.cells[:, :4]].mean(axis=1)
    near = centres[:, 2] < np.median(centres[:, 2])
    field = field_of(data, np.where(near, 1 / (2 * growth - 1), 1.0))
    path, parameters = gmsh_input.source_path("ball"), {"cells": 3.0, "order": 2.0}
    finer = gmsh_input.generate(path, "tetrahedron", parameters, field)
    assert 0.6 < len(finer.cells) / (growth * len(data.cells)) < 1.6
    z = finer.x[finer.cells[:, :4]].mean(axis=1)[:, 2]
    low, high = (volumes(finer)[half] for half in (z < -0.25, z > 0.25))
    assert np.median(high) > growth / 2 * np.median(low)
    assert [group.name for group in finer.groups] == [group.name for group in data.groups]
    surface = next(group for group in finer.groups if group.name == "surface")
    radii = np.linalg.norm(finer.x[np.unique(surface.entities)], axis=1)
    assert radii == pytest.approx(0.5, abs=1e-12)
    mesh = meshes.distribute(COMM, "finer", lambda: finer)
    assert meshes.volume(mesh.domain) == pytest.approx(pi / 6, rel=2e-3)


@mpi
def test_levels_of_a_round_body_are_finer_where_the_error_is():
    """A ball's octant that is pulled at a clamped face, whose edge is singular."""
    keys = {"order": 2, "radius": 1.0, "zone": 1.0}
    scene = scenes.Scene(
        name="ball", mesh={"source": "indenter", "parameters": keys}, cells=3, element="P2",
        steps=1, material={"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3},
        hold=[{"group": "x = 0"}, {"group": "y = 0", "components": ("y",)}],
        traction=[{"group": "z = 0", "vector": (0, 0.02, 0.05)}],
        accuracy={"goals": ["energy"], "within": 0.005, "max_time": 60},
    )  # fmt: skip
    result = fem_snh.run(scene, progress=False)
    found = result.record["accuracy"]
    assert found["reached"] and len(found["levels"]) > 1
    even = meshes.generate(MPI.COMM_WORLD, "indenter", "tetrahedron", cells=6, **keys)
    assert spread(result.problem.domain) > 2 * spread(even.domain)


def spread(domain):
    """The volume that nine of ten cells are smaller than, over that which nine are larger than."""
    sizes = np.concatenate(domain.comm.allgather(meshes.cell_volumes(domain)))
    smallest, largest = np.percentile(sizes, (10, 90))
    return largest / smallest


def refined(data, errors, rates, growth, left=0.0):
    """The mesh that is bisected where the errors are, and the cells from which its cells come."""
    sizes = VertexSizes(data.cells[:, :3], data.x)

    def at_corners(factor):
        wanted = target_volumes(
            volumes(data), errors, rates, 2, 2, factor * len(data.cells),
            sizes.expected, left if factor <= growth else 0.0,
        )  # fmt: skip
        return sizes.at_corners(wanted)

    return bisect_times(data, at_corners, growth, 10**6)


def square(cells=8):
    return meshes.gather(meshes.generate(COMM, "cook", "triangle", cells=cells))


def test_equal_errors_are_refined_everywhere():
    data = square()
    errors, rates = np.ones(len(data.cells)), np.full(len(data.cells), 4.0)
    for left in (0.0, 0.6):  # so little that no cell is to be half as large
        finer, parents = refined(data, errors, rates, 4.0, left)
        assert len(finer.cells) >= (1.3 if left else 3) * len(data.cells)
        assert np.bincount(parents, volumes(finer)) == pytest.approx(volumes(data))


def test_a_singular_cell_is_graded():
    """Few cells make those at a vertex much smaller; the rate is measured from their errors."""
    data = square()
    n = len(data.cells)
    near = (data.cells[:, :3] == data.cells[n // 2, 0]).any(axis=1)
    errors = np.where(near, 1.0, 1e-4)
    finer, parents = refined(data, errors, np.where(near, 0.25, 4.0), 4.0, left=0.01)
    assert len(finer.cells) < 5 * n
    assert volumes(finer).min() < volumes(data)[near].min() / 15
    lineage = Lineage(parents, errors, np.full(n, 4.0))
    parts = np.bincount(parents, minlength=n)
    left = (errors * parts ** (-0.5 / 2) / parts)[parents]  # as with a rate of 0.5
    found = measured_rates(left, lineage, 2, 2)
    assert found[near[parents]] == pytest.approx(0.5)
    assert (measured_rates(left, None, 2, 2) == 4).all()


def test_an_effectivity_says_nothing_of_a_part_that_did_not_change():
    """A quarter of the change is where half of the error is, or it was measured elsewhere."""
    parents, before = np.repeat(np.arange(4), 2), np.array([2.0, 10.0, 10.0, 10.0])
    kept = np.array([1.0, 0.9, 0.25, 0.25, 0.25, 0.25, 0.25, 0.25])  # of 2.0, 1.9 are left
    assert unmeasured(kept, 3.4, parents, before) == 2.0
    assert unmeasured(kept, 1.7, parents, before) == 2.0
    assert unmeasured(kept, 1.6, parents, before) == 0.0  # others cancel
    assert unmeasured(before[parents] / 8, 8.0, parents, before) == 0.0
    assert unmeasured(np.where(parents == 0, 0.5, kept), 2.5, parents, before) == 0.0
    assert unmeasured(0 * kept, 0.0, parents, before) == 0.0


def test_thin_cells_beside_refined_ones_stay_as_they_are():
    """With sizes that grow with the distance, cells at all thin ones became as small as these."""
    data = square()
    x = data.x.copy()
    x[:, 0] = x[:, 0].max() * (x[:, 0] / x[:, 0].max()) ** 6  # 1e5 times thinner at one side
    thin, n = data._replace(x=x), len(data.cells)
    largest = volumes(thin).argmax()
    errors = np.where(np.arange(n) == largest, 1.0, 1e-9)
    counts = []
    for mesh in (data, thin):
        finer, parents = refined(mesh, errors, np.full(n, 4.0), 1.5)
        assert np.bincount(parents)[largest] > 1
        counts.append(len(finer.cells))
    assert counts[1] < 1.3 * counts[0]
