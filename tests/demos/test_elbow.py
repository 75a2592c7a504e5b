"""The elbow flexion of Smith et al. 2018, Figures 2 and 10, on coarse meshes."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

import fem_snh
from fem_snh.mesh import mesh as meshes
from fem_snh.mesh import mesh_checks

mpi = pytest.mark.mpi
CELLS = 14


def flexed(scene="elbow", cells=CELLS, **overrides):
    return fem_snh.run(scene, cells=cells, progress=False, **overrides)


@pytest.mark.one_debian
@mpi
def test_arm_is_flesh_around_two_bones(comm):
    arm = meshes.generate(comm, "arm", "tetrahedron", cells=40)
    assert arm.num_cells == pytest.approx(11_200, rel=0.05)
    assert comm.allreduce(mesh_checks.scaled_jacobian(arm.domain).min(), op=min) > 0.05
    parts = [arm.group(name).count for name in ("flesh", "humerus", "ulna")]
    assert sum(parts) == arm.num_cells
    volumes = meshes.cell_volumes(arm.domain)
    for name, length in (("humerus", np.hypot(0.211, 0.012)), ("ulna", np.hypot(0.177, 0.012))):
        cells = arm.group(name).entities
        volume = comm.allreduce(volumes[cells[cells < len(volumes)]].sum())
        capsule = pi * 0.011**2 * (length + 4 / 3 * 0.011)
        assert 0.85 < volume / capsule < 1  # its polyhedron is inscribed


@pytest.mark.one_debian
@mpi
def test_volume_rises_with_the_ratio_of_poisson(comm):
    """Figure 2, beyond a right angle: at 90 and at 120 degrees."""
    results = {nu: flexed(nu=nu, angle=120.0, steps=4) for nu in (0.0, 0.3, 0.45, 0.499)}
    results[0.488] = flexed(nu=0.488, angle=120.0, steps=12)
    for load in (0.75, 1.0):
        volumes = []
        for nu in sorted(results):
            assert results[nu].converged
            (step,) = [s for s in results[nu].steps if abs(s["load"] - load) < 1e-12]
            volumes.append(step["volumes"]["flesh"])
        assert volumes == sorted(volumes) and volumes[0] < 0.991
        assert 0.995 < volumes[3] < 1 and abs(volumes[4] - 1) < 2e-4
    newton = [step["newton"] for step in results[0.488].steps]
    assert len(newton) == 12 and max(newton) <= 8


@pytest.mark.one_debian("ranks")
@mpi
def test_bones_keep_their_volume(comm):
    """The body's volume is the sum of its parts'; bones are rigid."""
    setup = {"steps": 2, "angle": 45.0, "nu": 0.3, "volumes": ["flesh", "humerus", "ulna"]}
    result = flexed(**setup)
    for step in result.steps:
        assert step["volumes"]["humerus"] == pytest.approx(1, abs=1e-12)
        assert step["volumes"]["ulna"] == pytest.approx(1, abs=1e-12)
        # (V - V0) / V0 of the body against that of the flesh, whose part is 0.91 to 0.97.
        part = (1 - step["volume_ratio"]) / (1 - step["volumes"]["flesh"])
        assert 0.91 < part < 0.97


@pytest.mark.one_debian
def test_stvk_needs_more_iterations_and_loses_volume():
    """Smith et al. 2018, Figure 10, at the scene's size: 2.3 times the iterations.

    On coarse meshes the ratio is from 1.7 to 2.4, as the mesh and rounding have it.
    """
    runs = {
        material: fem_snh.run("biceps", material=material, progress=False)
        for material in ("stable_neo_hookean", "stvk_kikuuwe")
    }
    assert all(result.converged for result in runs.values())
    newton = [sum(step["newton"] for step in result.steps) for result in runs.values()]
    volume = [result.steps[-1]["volumes"]["flesh"] for result in runs.values()]
    assert newton[1] > 1.8 * newton[0]
    assert volume[0] - volume[1] > 0.02 and volume[0] > 0.997
