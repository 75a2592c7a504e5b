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
from fem_snh.mesh import gmsh_input
from fem_snh.mesh import mesh as meshes
from fem_snh.mesh.bisection import size_field

mpi = pytest.mark.mpi
COMM = MPI.COMM_SELF


def field_of(data, factor):
    """The field with which each cell of a mesh has its volume times a factor."""
    dim = data.x.shape[1]
    mesh = meshes.distribute(COMM, "mesh", lambda: data)
    return size_field(data.cells[:, : dim + 1], data.x, factor * meshes.cell_volumes(mesh.domain))


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
    assert found["reached"] and len(found["levels"]) == 2
    before, after = (level["cells"] for level in found["levels"])
    assert 0.6 < after / (8 * before) < 1.7
    even = meshes.generate(MPI.COMM_WORLD, "indenter", "tetrahedron", cells=6, **keys)
    assert spread(result.problem.domain) > 2 * spread(even.domain)


def spread(domain):
    """The volume that nine of ten cells are smaller than, over that which nine are larger than."""
    sizes = np.concatenate(domain.comm.allgather(meshes.cell_volumes(domain)))
    smallest, largest = np.percentile(sizes, (10, 90))
    return largest / smallest
