"""The first meshes of runs to an accuracy whose goals are stresses around points."""

from __future__ import annotations

from functools import partial

from mpi4py import MPI

import numpy as np
import pytest
from paths import DATA

from fem_snh import _dolfinx
from fem_snh.accuracy.goals import MOST_RADII, sizes_near
from fem_snh.mesh.mesh import cell_volumes
from fem_snh.runs.level_meshes import fine_at, mesh_like, stress_probes
from fem_snh.scenes import Accuracy, Probe, Scene

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
