"""Groups of cells and materials that pictures hide, and the mark of the smallest J."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from mpi4py import MPI

import numpy as np
import pytest
from picture_runs import bad
from running import record, solve
from scene_file import TWO_MATERIALS

from fem_snh import _dolfinx
from fem_snh.assembly.regions import Region
from fem_snh.kernels.material import material
from fem_snh.mesh import mesh
from fem_snh.mesh.mesh import Group
from fem_snh.runs.output.fields import cell_groups
from fem_snh.viewing import render
from fem_snh.viewing.render import surfaces
from fem_snh.viewing.states import InterpolatedStates
from fem_snh.viewing.stored_run import view_options

mpi = pytest.mark.mpi


def grid_of(run: render.StoredRun, load: float = 1.0) -> Any:
    return surfaces.read_grid(run.states[load], "J", run.view.hidden_cells)


@mpi
def test_groups_and_materials_are_hidden(comm, folder):
    """A bar of two halves: one is a group with a material, the other has the rest."""
    if comm.rank == 0:
        (folder / "bar.toml").write_text(TWO_MATERIALS)
    comm.barrier()
    solve(folder / "bar.toml", cells=2, out=folder / "out")
    comm.barrier()
    groups = record(folder / "out")["cell_groups"]
    (second,) = [i for i, names in enumerate(groups) if "second" in names]
    assert groups[second] == ["second", "stable_neo_hookean"] and len(groups) == 2
    assert "neo_hookean" in groups[1 - second]
    whole = grid_of(render.StoredRun(folder / "out", "J"))
    stiff = np.asarray(whole.cell_centers().points)[:, 0] > 1
    for hide, left in (("second", ~stiff), ("neo_hookean", stiff)):
        run = render.StoredRun(folder / "out", "J", view_options(hide=[hide]))
        grid = grid_of(run)
        assert grid.n_cells == left.sum() == whole.n_cells / 2
        assert sorted(grid["J"]) == pytest.approx(sorted(whole["J"][left]))
        states = InterpolatedStates(run.states, "J", run.view.hidden_cells)
        assert states.grid(0.7).n_cells == grid.n_cells
    message = bad(lambda: render.StoredRun(folder / "out", "J", view_options(hide=["third"])))
    known = ", ".join(dict.fromkeys(name for names in groups for name in names))
    assert message == f"--hide = 'third': expected one of {known}"
    every = view_options(hide=["second", "neo_hookean"])
    message = bad(lambda: grid_of(render.StoredRun(folder / "out", "J", every)))
    assert message.startswith("--hide: nothing of the body is left")
    comm.barrier()


@mpi
def test_parts_of_overlapping_groups(comm):
    """Each set of groups is a part; cells without a material are one of their own."""
    cube = mesh.generate(comm, "cube", "hexahedron", cells=2)
    count = _dolfinx.num_owned(cube.domain)
    x = _dolfinx.geometry_x(cube.domain)[_dolfinx.geometry_dofs(cube.domain)].mean(axis=1)[:count]
    low, left = (np.flatnonzero(x[:, axis] < 0.5).astype(np.int32) for axis in (2, 0))
    groups = (Group("low", 3, 1, low, 4), Group("left", 3, 2, left, 4), Group("top", 2, 1, low, 4))
    cells = np.arange(count, dtype=np.int32)
    solid = material("stable_neo_hookean", E=1.0, nu=0.3)
    found = cell_groups(replace(cube, groups=groups), [Region(solid, cells)])
    assert found is not None
    assert found.names == [[], ["left"], ["low"], ["low", "left"]]
    assert np.array_equal(found.numbers, 2 * (x[:, 2] < 0.5) + (x[:, 0] < 0.5))
    assert cell_groups(replace(cube, groups=()), [Region(solid, cells)]) is None
    soft = material("neo_hookean", E=1.0, nu=0.3)
    halves = [Region(solid, low), Region(soft, np.intersect1d(left, np.setdiff1d(cells, low)))]
    found = cell_groups(replace(cube, groups=()), halves)
    assert found is not None
    assert found.names == [[], ["stable_neo_hookean"], ["neo_hookean"]]
    assert comm.allreduce(np.bincount(found.numbers, minlength=3), op=MPI.SUM).tolist() == [2, 4, 2]
