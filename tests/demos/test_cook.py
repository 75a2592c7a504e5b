"""Cook's membrane: its mesh, its balance, the published displacements."""

from __future__ import annotations

from typing import Any

from mpi4py import MPI

import numpy as np
import pytest

import fem_snh
from fem_snh import _dolfinx
from fem_snh.mesh import mesh

mpi = pytest.mark.mpi

#: deal.II's code gallery, "Quasi-static finite-strain compressible elasticity": u_y at (48, 52).
COMPRESSIBLE = {"force": 1.0, "E": 2 * 0.4225 * 1.3, "nu": 0.3}
PUBLISHED = {"Q1": {2: 8.638, 4: 12.07, 8: 13.86, 16: 14.49}, "Q2": {2: 14.30, 4: 14.65, 8: 14.71}}


def solve(comm: Any = MPI.COMM_WORLD, **kwargs: Any) -> Any:
    return fem_snh.run("cook", comm=comm, progress=False, **kwargs)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("cell", ["hexahedron", "tetrahedron"])
def test_the_mesh_is_one_layer_of_the_panel(comm: MPI.Comm, cell: str) -> None:
    made = mesh.generate(comm, "cook", cell, cells=4)
    assert made.num_cells in (16, 96)
    x = _dolfinx.geometry_x(made.domain)
    assert set(np.unique(x[:, 2])) == {0, 1}
    left = 44 / 48 * x[:, 0]
    right = 44 + 16 / 48 * x[:, 0]
    assert (x[:, 1] > left - 1e-9).all() and (x[:, 1] < right + 1e-9).all()
    per_face = 1 if cell == "hexahedron" else 2
    for group in ("left", "right", "top", "bottom"):
        assert made.group(group).count == 4 * per_face
    assert made.group("faces").count == 2 * 16 * per_face
    element = "Q1" if cell == "hexahedron" else "P1"
    problem = solve(comm, kinematics="layer", cells=4, element=element).problem
    assert problem.length**3 == pytest.approx(48 * (44 + 16) / 2, rel=1e-12)


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("kinematics", ["layer", "plane_strain"])
@pytest.mark.parametrize("element", PUBLISHED)
def test_compressible_displacements_are_those_published(
    comm: MPI.Comm, element: str, kinematics: str
) -> None:
    """All that is printed: four digits, by the layer and by the panel alone."""
    for cells, published in PUBLISHED[element].items():
        result = solve(element=element, cells=cells, kinematics=kinematics, **COMPRESSIBLE)
        assert result.converged
        tip = result.steps[-1]["probes"]["tip"]
        assert tip[1] == pytest.approx(published, rel=5e-4)
        assert tip[2] == pytest.approx(0, abs=1e-6)


@pytest.mark.one_debian("ranks")
@mpi
def test_the_support_holds_the_force(comm: MPI.Comm) -> None:
    """The faces' support has no share in the plane; moments are not looked at."""
    tight = {"snes_scaled_tol": 1e-10, "snes_forcing_max": 0, "ksp_rtol": 1e-8}
    result = solve(kinematics="layer", element="Q1", cells=6, steps=2, petsc=tight, **COMPRESSIBLE)
    for step in result.steps:
        force = step["reactions"]["left"]
        assert force[:2] == pytest.approx([0, -step["load"]], abs=1e-6)


@pytest.mark.one_debian
def test_full_integration_locks_when_nearly_incompressible() -> None:
    """Coarse Q1 is too stiff by tens of per cent, coarse Q2 by few: 6.9 is published."""
    locked, finer = (
        solve(kinematics="layer", element=element, cells=8).steps[-1]["probes"]["corner"][1]
        for element in ("Q1", "Q2")
    )
    assert locked < 0.75 * finer
    assert 6.4 < finer < 6.9
