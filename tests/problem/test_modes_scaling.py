"""Frequencies of bodies of other sizes, materials and numbers of ranks."""

from __future__ import annotations

from mpi4py import MPI

import numpy as np
import pytest
from bodies import Hold, cube, problem

import fem_snh
from fem_snh.problem import modes
from fem_snh.scenes import Geometry

mpi = pytest.mark.mpi


def solve(scene="modes", comm=MPI.COMM_WORLD, **kwargs):
    return fem_snh.run(scene, comm=comm, progress=False, **kwargs)


# --- scaling, materials, ranks -------------------------------------------------------------------


@pytest.mark.one_debian
@mpi
def test_frequencies_scale_as_the_square_root_of_E_over_density_over_length(comm):
    found = []
    for E, density, size in ((1.0, 1.0, 1.0), (200e9, 7800.0, 1e-3), (1e3, 1e3, 50.0)):
        p = problem(cube(comm, "hexahedron", 2, size=size), "Q1", E=E, hold=[Hold("left")])
        unit = np.sqrt(E / density) / size
        found.append(np.array(modes.lowest(p, density, 5).frequencies) / unit)
    assert found[1] == pytest.approx(found[0], rel=1e-9)
    assert found[2] == pytest.approx(found[0], rel=1e-9)


@mpi
@pytest.mark.parametrize("free", [False, True])
def test_any_number_of_ranks_gives_the_same_frequencies(comm, free):
    setup = {"cells": 3, "count": 10, "aspect": 1.5, "element": "P2"}
    setup |= {"hold": []} if free else {}
    alone, together = solve(comm=MPI.COMM_SELF, **setup), solve(comm=comm, **setup)
    one, other = alone.frequencies, together.frequencies
    assert other == pytest.approx(one, rel=1e-9, abs=1e-6 * one[-1])
    start = 6 if free else 0
    assert other[start:] == pytest.approx(one[start:], rel=1e-9)


@pytest.mark.one_debian("ranks")
@mpi
def test_modes_of_a_loaded_state_come_after_the_load_steps(comm):
    """A pulled bar is stiffer across: its lowest frequency rises, as a string's."""
    setup = {"cells": 3, "steps": 1, "mesh": Geometry(source="cube"), "modes": {"count": 2}}
    found = [solve("pull", stretch=s, **setup) for s in (1.0 + 1e-9, 1.5)]
    assert found[1].frequencies[0] != pytest.approx(found[0].frequencies[0], rel=1e-2)
    assert all(step["reactions"] for step in found[1].steps)
