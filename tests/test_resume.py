"""Runs that are cut off and gone on with: the same end, on any number of ranks."""

from __future__ import annotations

import json
import re
from contextlib import contextmanager

from mpi4py import MPI

import numpy as np
import pytest
from bodies import PRESS

import fem_snh
from fem_snh.atomic_files import check_whole, replace_file
from fem_snh.errors import BadInput
from fem_snh.runs import checkpoint, nodal_values
from fem_snh.runs.stepping import Stepper

mpi = pytest.mark.mpi
ALONE, ALL = MPI.COMM_SELF, MPI.COMM_WORLD


class CutOff(Exception):
    """What ends a run in these tests, as nothing else of it would notice."""


@contextmanager
def cut(steps):
    """A run within ends when it attempts its step after so many."""
    attempt, left = Stepper._attempt, [steps]

    def attempted(self, *arguments):
        if not left[0]:
            raise CutOff
        left[0] -= 1
        return attempt(self, *arguments)

    Stepper._attempt = attempted
    try:
        yield
    except CutOff:
        pass
    finally:
        Stepper._attempt = attempt


def solve(scene, comm=ALL, **options):
    """A run on all ranks, or on the first one alone while the others wait."""
    try:
        if comm is ALL or ALL.rank == 0:
            return fem_snh.run(scene, comm=comm, progress=False, **options)
    finally:
        ALL.barrier()


def record(folder):
    return json.loads((folder / "run.json").read_text())


def difference(one, other):
    """The largest difference of any unknown between two checkpoints."""
    (_, a), (_, b) = checkpoint.load(one), checkpoint.load(other)
    gaps = []
    for name in ("u", "p"):
        if name in a:
            order = nodal_values.match_nodes(a[f"{name}_nodes"], b[f"{name}_nodes"])
            gaps.append(abs(a[name] - b[name][order]).max())
    return max(gaps)


def times(folder):
    return [
        float(t) for t in re.findall(r'timestep="([^"]+)"', (folder / "fields.pvd").read_text())
    ]


# --- the same end --------------------------------------------------------------------------------

# At nu = 0.49 so coarse a body leaves its symmetric states, and the trust region is called.
STRETCH = {"cells": 3, "steps": 5, "stretch": 2.0, "nu": 0.3}
#: Scene, options, rows after which it is cut off.
CASES = {
    "extrapolate": ("stretch", STRETCH, 3),
    "tangent": ("stretch", STRETCH | {"predictor": "tangent", "element": "P2"}, 2),
    "before its first step": ("stretch", STRETCH, 0),
    "pressure": ("stretch", STRETCH | {"element": "Q2Q1", "nu": 0.5}, 2),
    "halved": (PRESS, {}, 4),
    "traction": ("cook", {"cells": 3, "element": "Q1", "steps": 3}, 2),
}


@mpi
@pytest.mark.parametrize("case", CASES)
def test_on_the_same_ranks_it_is_the_same_to_the_last_digit(comm, folder, case):
    scene, options, steps = CASES[case]
    whole = solve(scene, out=folder / "whole", **options)
    with cut(steps):
        solve(scene, out=folder / "cut", **options)
    left = record(folder / "cut")
    assert len(left["steps"]) == steps and not left["converged"]
    again = solve(scene, out=folder / "cut", resume=True, **options)
    comm.barrier()
    found = record(folder / "cut")
    assert found["converged"] and again.converged
    accepted = [step["load"] for step in left["steps"] if step["converged"]]
    assert found["resumed"] == [accepted[-1] if accepted else 0.0]
    assert len(again.steps) == len(whole.steps)
    for one, other in zip(whole.steps, again.steps, strict=True):
        assert one | {"seconds": 0} == other | {"seconds": 0}
    assert np.array_equal(whole.problem.x.array, again.problem.x.array)
    assert times(folder / "cut") == times(folder / "whole")
    comm.barrier()


@mpi
@pytest.mark.parametrize("case", ["extrapolate", "pressure"])
@pytest.mark.parametrize("before, after", [(ALONE, ALL), (ALL, ALONE)], ids=["1-all", "all-1"])
def test_on_another_number_of_ranks_it_is_the_same_to_the_solvers_tolerance(
    comm, folder, case, before, after
):
    scene, options, steps = CASES[case]
    options = options | {"petsc": {"snes_scaled_tol": 1e-10}}
    solve(scene, out=folder / "whole", **options)
    with cut(steps):
        solve(scene, before, out=folder / "cut", **options)
    assert len(record(folder / "cut")["steps"]) == steps
    solve(scene, after, out=folder / "cut", resume=True, **options)
    found, whole = record(folder / "cut"), record(folder / "whole")
    assert found["converged"] and found["ranks"] == after.size
    energies = [[step["energy"] for step in each["steps"]] for each in (found, whole)]
    assert energies[0] == pytest.approx(energies[1], rel=1e-9)
    assert difference(folder / "cut", folder / "whole") < 1e-8
    assert times(folder / "cut") == times(folder / "whole")
    comm.barrier()


@mpi
def test_resumed_twice_its_fields_are_whole(comm, folder):
    """And its seconds are those of all three."""
    pyvista = pytest.importorskip("pyvista")
    for number, comms in enumerate((ALL, ALONE)):
        with cut(2):
            solve("stretch", comms, out=folder, resume=number > 0, **STRETCH)
    earlier = record(folder)["seconds"]["total"]
    solve("stretch", out=folder, resume=True, **STRETCH)
    found = record(folder)
    assert found["resumed"] == [0.4, 0.8] and found["converged"]
    assert found["seconds"]["total"] > earlier + found["steps"][-1]["seconds"]
    loads = [step["load"] for step in found["steps"]]
    assert loads == [0.2, 0.4, 0.6, 0.8, 1.0]
    reader = pyvista.get_reader(str(folder / "fields.pvd"))
    assert reader.time_values == pytest.approx([0.0, *loads])
    for time_value, step in zip(reader.time_values[1:], found["steps"], strict=True):
        reader.set_active_time_value(time_value)
        grid = reader.read().combine()
        assert grid.n_cells == found["cells"]
        right = grid.points[:, 0] > grid.points[:, 0].max() - 1e-9
        assert grid.point_data["displacement"][right, 0] == pytest.approx(step["load"], abs=1e-12)
    assert not [file for file in folder.iterdir() if file.name.startswith(".")]
    comm.barrier()


# --- what may be resumed, and what may not -------------------------------------------------------


@mpi
def test_a_finished_run_is_left_as_it_is(comm, folder):
    whole = solve("stretch", out=folder, **STRETCH)
    comm.barrier()
    files = {file: file.stat().st_mtime_ns for file in folder.iterdir()}
    again = solve("stretch", out=folder, resume=True, **STRETCH)
    assert again.converged and again.steps == record(folder)["steps"]
    assert np.array_equal(again.u.x.array, whole.u.x.array)
    assert {file: file.stat().st_mtime_ns for file in folder.iterdir()} == files
    comm.barrier()


@mpi
@pytest.mark.parametrize(
    "other, key",
    [
        ({"nu": 0.4}, r"material\.nu = 0\.4, but it was run with 0\.3"),
        ({"E": 2.0}, r"material\.E = 2\.0, but it was run with 1\.0"),
        ({"cells": 4}, "cells = 4, but it was run with 3"),
        ({"element": "P1"}, 'element = "P1", but it was run with "Q1"'),
        ({"steps": 7}, "steps = 7"),
        ({"material.barrier": True}, r"material\.barrier = true, but it was run with nothing"),
    ],
)
def test_another_scene_is_refused_by_its_key(comm, folder, other, key):
    with cut(1):
        solve("stretch", out=folder, **STRETCH)
    with pytest.raises(BadInput, match="cannot resume .*: " + key):
        solve("stretch", out=folder, resume=True, **STRETCH | other)
    comm.barrier()


@mpi
def test_another_way_to_solve_it_is_accepted(comm, folder):
    with cut(2):
        solve("stretch", out=folder, **STRETCH)
    other = {"hessian": "clamp", "predictor": "tangent", "petsc": {"ksp_type": "minres"}}
    again = solve("stretch", out=folder, resume=True, **STRETCH | other)
    assert again.converged and again.record["linear_solver"] == "minres+jacobi"
    comm.barrier()


@mpi
def test_without_a_checkpoint_it_says_what_to_do(comm, folder):
    with pytest.raises(BadInput, match=r"there is no folder .* start without --resume"):
        solve("stretch", out=folder / "none", resume=True)
    assert not (folder / "none").exists()
    with pytest.raises(BadInput, match=r"has no checkpoint\.npz .* start without --resume$"):
        solve("stretch", out=folder, resume=True)
    if comm.rank == 0:
        (folder / "run.json").write_text("{}")
    comm.barrier()
    with pytest.raises(BadInput, match="start without --resume, with --overwrite"):
        solve("stretch", out=folder, resume=True)
    if comm.rank == 0:
        (folder / "checkpoint.npz").write_bytes(b"PK nothing")
    comm.barrier()
    with pytest.raises(BadInput, match=r"checkpoint\.npz cannot be read"):
        solve("stretch", out=folder, resume=True)
    with pytest.raises(BadInput, match="without --overwrite"):
        solve("stretch", out=folder, resume=True, overwrite=True)
    with pytest.raises(BadInput, match="--resume: expected with --out"):
        solve("stretch", resume=True)


# --- parts ---------------------------------------------------------------------------------------


def test_nodes_are_found_by_their_places():
    rng = np.random.default_rng(0)
    nodes = rng.uniform(size=(200, 3))
    order = rng.permutation(200)
    assert np.array_equal(nodal_values.match_nodes(nodes[order] + 1e-13, nodes), order)
    with pytest.raises(BadInput, match="another mesh: it has 199 nodes, the checkpoint 200"):
        nodal_values.match_nodes(nodes[1:], nodes)
    with pytest.raises(BadInput, match="another mesh: 200 of its 200 nodes are not"):
        nodal_values.match_nodes(nodes[order] + 1e-3, nodes)
    nodes[1] = nodes[0]
    assert np.array_equal(nodal_values.match_nodes(nodes, nodes), np.arange(200))
    with pytest.raises(BadInput, match="some nodes are at one place"):
        nodal_values.match_nodes(nodes[order], nodes)


def test_files_are_old_or_new(tmp_path):
    path = tmp_path / "file"
    replace_file(path, "old")

    def fails(file):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    with pytest.raises(BadInput, match=r"cannot write .*file: No space left on device"):
        replace_file(path, fails)
    assert path.read_text() == "old" and list(tmp_path.iterdir()) == [path]
    replace_file(path, lambda file: file.write(b"new"), sync=True)
    assert path.read_text() == "new"
    check_whole(path, path, b"new")
    with pytest.raises(BadInput, match=r"cannot write .*other: it was cut short"):
        check_whole(path, tmp_path / "other", b"newer")


@mpi
def test_a_direct_solver_is_not_left_waiting(comm):
    """For a monitor, PETSc's preonly computes a norm: so either all ranks have one, or none."""
    direct = {"ksp_type": "preonly", "pc_type": "cholesky", "pc_factor_mat_solver_type": "mumps"}
    assert solve("twist", cells=3, petsc=direct).converged
