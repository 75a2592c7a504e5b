"""The first meshes of runs to an accuracy whose goals are stresses around points."""

from __future__ import annotations

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from paths import DATA
from running import solve

from fem_snh import _dolfinx
from fem_snh.accuracy.goals import MOST_RADII, sizes_near
from fem_snh.mesh.mesh import cell_volumes
from fem_snh.runs.level_meshes import fine_at, mesh_like, stress_probes
from fem_snh.scenes import Accuracy, Probe, Scene, load

_BUSH = DATA / "bush.xao"
_SOFT = {"name": "stable_neo_hookean", "E": 1.0, "nu": 0.3}


def probed(mesh, point, radius, **keys):
    probes = [Probe(name="there", point=point, radius=radius)]
    accuracy = Accuracy(goals=["there.stress"], within=0.01)
    return Scene(name="probed", mesh=mesh, material=_SOFT, probe=probes, accuracy=accuracy, **keys)


@pytest.mark.mpi
@pytest.mark.parametrize(
    ("mesh", "point", "radius", "keys", "volume"),
    [
        ({"source": "bracket"}, (0.9, 2.1, 0.5), 0.02, {"cells": 2}, 5.0),
        ({"source": "bracket"}, (0.9, 2.1, 0), 0.005,
         {"cells": 1, "kinematics": "plane_strain"}, 5.0),
        (_BUSH, (10, 0, 3), 0.3, {"cells": 4}, np.pi * (16**2 - 10**2) * 20),
    ],
)  # fmt: skip
def test_cells_are_small_at_the_point_alone(comm, mesh, point, radius, keys, volume):
    """Whether they are bisected or a shape is meshed again; the body stays as it is."""
    scene = probed(mesh, point, radius, element="P2", **keys)
    again = partial(mesh_like, scene) if mesh == _BUSH else None
    made = fine_at(comm, scene, stress_probes(scene), again)
    domain, owned = made.domain, _dolfinx.num_owned(made.domain)
    x = _dolfinx.geometry_x(domain)[_dolfinx.geometry_dofs(domain)][:owned, :, : made.dim]
    sizes = sizes_near(x, np.array(point[: made.dim]), radius)
    largest = comm.allreduce(float(sizes.max(initial=0)), op=MPI.MAX)
    assert 0.1 * MOST_RADII * radius < largest <= MOST_RADII * radius
    near, cells = (comm.allreduce(int(n)) for n in (np.count_nonzero(sizes), owned))
    cubes = volume / (MOST_RADII * radius) ** made.dim
    assert near > 8 and cells < cubes  # of cells of this size everywhere at least 5 a cube
    total = comm.allreduce(float(cell_volumes(domain)[:owned].sum()))
    assert total == pytest.approx(volume, rel=1e-12 if isinstance(mesh, dict) else 2e-3)


@pytest.mark.parametrize(("element", "cells"), [("P2P1", 2), ("Q2Q1", 16)])
def test_an_accuracy_is_reached_at_a_small_radius(element, cells):
    """It was refused, as cells of the first level are larger; those of 48 cells fit the radius.

    Hexahedra are not refined at the point: the first level has all cells of the scene.
    """
    probes = [Probe(name="inside", point=(24, 35, 0), radius=1.0)]
    keys = {"kinematics": "plane_strain", "nu": 0.49, "steps": 2, "probe": probes}
    scene = load("cook", element=element, cells=cells, **keys)
    goals = {"goals": ["inside.stress"], "keep_element": True}
    found = solve(scene.model_copy(update={"accuracy": Accuracy(within=0.01, **goals)}))
    fine = load("cook", element="Q2Q1", cells=32, error=True, **keys)
    exact = solve(fine.model_copy(update={"accuracy": Accuracy(goals=["inside.stress"])}))
    value = exact.goals["inside.stress"]["corrected"]
    accuracy = found.record["accuracy"]
    best = accuracy["levels"][-1]["goals"]["inside.stress"]["best"]
    assert accuracy["reached"] and best == pytest.approx(value, rel=0.01)
