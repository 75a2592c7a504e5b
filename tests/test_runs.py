"""Whole runs: records and tables, halving, interruptions, ranks, stored numbers.

The stored numbers are made anew, after a change that is meant to change them, by

    .venv/bin/python tests/test_runs.py > tests/data/new.json && mv tests/data/{new,runs}.json
"""

from __future__ import annotations

import csv
import json
import re
import signal
import subprocess
import time
from itertools import pairwise
from pathlib import Path

from mpi4py import MPI
from petsc4py import PETSc

import numpy as np
import pytest
from bodies import PRESS

import fem_snh
from fem_snh import solver
from fem_snh.choices import GLOBALIZATIONS
from fem_snh.errors import BadInput, on_root
from fem_snh.fem import gmsh_input
from fem_snh.runs.folder import COLUMNS
from fem_snh.scenes import Geometry, Hold, MaterialChoice, Move, Rotate, Scene
from fem_snh.studies.processes import environment, program

mpi = pytest.mark.mpi
STORED = Path(__file__).parent / "data" / "runs.json"


def solve(scene="twist", comm=MPI.COMM_WORLD, **kwargs):
    return fem_snh.run(scene, comm=comm, progress=False, **kwargs)


def record(folder):
    return json.loads((folder / "run.json").read_text())


def rows(folder):
    with (folder / "steps.csv").open() as file:
        return list(csv.DictReader(file))


# --- what a run leaves ---------------------------------------------------------------------------

KEYS = {
    "scene", "material", "element", "hessian", "globalization", "terms", "cells", "dofs", "ranks",
    "converged", "status", "steps", "seconds", "peak_memory_mb", "versions", "load_name",
    "load_range", "quadrature", "eigensolver",
}  # fmt: skip


@mpi
def test_the_record_says_what_was_solved_and_how(comm, folder):
    result = solve("twist", cells=3, angle=0.6, out=folder / "new" / "run")
    folder = folder / "new" / "run"
    found = record(folder)
    assert set(found) >= KEYS
    assert found["material"] == {
        "name": "stable_neo_hookean",
        "E": 1.0,
        "nu": 0.49,
        "mu_lame": pytest.approx(1 / 2.98, rel=1e-10),
        "lambda_lame": pytest.approx(0.49 / (1.49 * 0.02), rel=1e-10),
        "parameters": dict(
            zip(("mu", "lam"), result.problem.material.expression.values, strict=True), barrier=None
        ),
    }
    plain = (
        "scene",
        "element",
        "hessian",
        "globalization",
        "terms",
        "cells",
        "dofs",
        "ranks",
        "status",
    )
    values = [
        "twist",
        "Q1",
        "adaptive",
        "trust_region",
        ["elastic"],
        27,
        192,
        comm.size,
        "converged",
    ]
    assert [found[key] for key in plain] == values
    assert found["converged"] is True and result.converged and result.status == "converged"
    assert (found["load_name"], found["load_range"]) == ("angle", [0, 0.6])
    assert set(found["seconds"]) == {"jit", "mesh", "setup", "assemble", "solve", "output", "total"}
    seconds = dict(found["seconds"])
    total = seconds.pop("total")
    assert all(value >= 0 for value in seconds.values()) and sum(seconds.values()) <= total
    assert {"fem_snh", "dolfinx", "petsc", "python"} <= set(found["versions"])
    assert found["peak_memory_mb"] > 10
    assert 0 < found["processor_seconds"] < 60

    assert [step["load"] for step in found["steps"]] == [0.5, 1.0]
    for step, seen in zip(found["steps"], rows(folder), strict=True):
        assert tuple(step) == (*COLUMNS, "reactions", "probes")
        vectors = step["reactions"] | step["probes"]
        assert tuple(seen)[: len(COLUMNS)] == COLUMNS
        assert len(seen) == len(COLUMNS) + 3 * len(vectors)
        assert step["converged"] is True and step["reason"].startswith("CONVERGED")
        assert step["newton"] > 0 and step["linear"] > step["newton"] >= step["clamped"] >= 0
        assert step["residual"] <= found["tolerance"]
        assert step["energy"] > 0 and 0.9 < step["volume_ratio"] < 1.1 and 0 < step["min_J"] <= 1.1
        assert float(seen["energy"]) == step["energy"] and int(seen["newton"]) == step["newton"]
    assert result.steps == result.record["steps"]
    for step, seen in zip(result.steps, found["steps"], strict=True):
        assert step | {"seconds": 0} == seen | {"seconds": 0}  # each rank has its own clock
    assert result.out == folder
    assert result.steps[-1]["energy"] == result.problem.energy(result.problem.x)
    comm.barrier()


@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_fields_are_read_by_pyvista(comm, folder, element):
    pyvista = pytest.importorskip("pyvista")
    result = solve("twist", cells=2, angle=0.8, element=element, out=folder)
    comm.barrier()
    reader = pyvista.get_reader(str(folder / "fields.pvd"))
    assert reader.time_values == [0.0, 0.5, 1.0]
    for time_value, step in zip((0.0, 0.5, 1.0), (None, *result.steps), strict=True):
        reader.set_active_time_value(time_value)
        grid = reader.read().combine()
        assert grid.n_cells == result.record["cells"]
        assert set(grid.cell_data.keys()) >= {"J", "energy_density", "min_eigenvalue"}
        u, J = grid.point_data["displacement"], grid.cell_data["J"]
        if step is None:
            assert not u.any() and J == pytest.approx(1, abs=1e-12)
            continue
        volumes = np.full(len(J), 1 / 8) if element == "Q1" else cell_volumes(grid)
        assert volumes @ J == pytest.approx(step["volume_ratio"], rel=1e-6)
        energy = volumes @ grid.cell_data["energy_density"]
        assert energy == pytest.approx(step["energy"], rel=1e-6)
        assert grid.cell_data["min_eigenvalue"].min() < 0
        assert J.min() >= step["min_J"] - 1e-12
        top = grid.points[:, 2] > 1 - 1e-9
        arm = grid.points[top] - [0.5, 0.5, 1]
        c, s = np.cos(0.8 * time_value), np.sin(0.8 * time_value)
        expected = arm @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T - arm
        assert u[top] == pytest.approx(expected, abs=1e-7)
    comm.barrier()


def cell_volumes(grid):
    """By the corners of tetrahedra."""
    corners = np.array([grid.get_cell(i).points[:4] for i in range(grid.n_cells)])
    return abs(np.linalg.det(corners[:, 1:] - corners[:, :1])) / 6


@mpi
def test_a_material_without_energy_has_none_in_its_record(comm, folder):
    """Null in run.json, nothing in steps.csv, no field; stresses are all that it has."""
    pyvista = pytest.importorskip("pyvista")
    result = solve("pull", cells=2, steps=2, material="filtered_neo_hookean", out=folder)
    comm.barrier()
    assert result.converged and not result.problem.has_energy
    assert [step["energy"] for step in result.steps] == [None, None]
    assert [step["energy"] for step in record(folder)["steps"]] == [None, None]
    assert [row["energy"] for row in rows(folder)] == ["", ""]
    assert all(row["residual"] and row["reaction_right_x"] for row in rows(folder))
    reader = pyvista.get_reader(str(folder / "fields.pvd"))
    reader.set_active_time_value(1.0)
    assert set(reader.read().combine().cell_data.keys()) & {
        "J",
        "energy_density",
        "min_eigenvalue",
    } == {"J", "min_eigenvalue"}
    with pytest.raises(BadInput, match="material 'filtered_neo_hookean' has no energy"):
        result.problem.energy(result.problem.x)
    comm.barrier()


@mpi
def test_what_was_done_to_a_material_is_in_the_record(comm):
    tuning = {"material.alpha_mu": 1.5, "material.lambda_part": "neo_hookean"}
    found = solve("pull", cells=1, steps=1, stretch=1.1, **tuning).record["material"]
    assert found["parameters"]["alpha_mu"] == 1.5
    assert found["parameters"]["lambda_part"] == "neo_hookean"
    assert found["mu_lame"] == pytest.approx(1 / 2.6) and found["nu"] == 0.3


@mpi
def test_without_a_folder_nothing_is_written(comm, folder, monkeypatch):
    monkeypatch.chdir(folder)
    result = solve("twist", cells=1, angle=0.3)
    comm.barrier()
    assert result.out is None and not list(folder.iterdir())
    comm.barrier()


# --- folders -------------------------------------------------------------------------------------


@mpi
def test_a_folder_with_a_run_is_refused_unless_told(comm, folder):
    tiny = {"cells": 1, "angle": 0.1, "out": folder}
    solve("twist", steps=3, **tiny)
    comm.barrier()
    before = (folder / "run.json").read_text()
    with pytest.raises(BadInput, match=r"already holds a run: give --overwrite or another --out"):
        solve("twist", **tiny)
    assert (folder / "run.json").read_text() == before
    comm.barrier()
    (folder / f"mine{comm.rank}.txt").write_text("kept")
    comm.barrier()
    solve("twist", steps=1, overwrite=True, **tiny)
    comm.barrier()
    assert [step["load"] for step in record(folder)["steps"]] == [1.0]
    names = {path.name for path in folder.iterdir()}
    assert "mine0.txt" in names and not [n for n in names if n.startswith(".")]
    assert not [n for n in names if re.search(r"fields.*0*3\.p?vtu$", n)]  # of the longer run
    comm.barrier()


@mpi
def test_a_folder_that_cannot_be_written_is_bad_input_on_every_rank(comm, folder):
    (folder / "file").write_text("a file")
    comm.barrier()
    for place in (folder / "file", folder / "file" / "run", Path("/proc/nowhere/run")):
        with pytest.raises(BadInput, match=r"output folder .* cannot be written \(.+\): choose"):
            solve("twist", cells=1, out=place)


# --- steps that fail -----------------------------------------------------------------------------


@mpi
def test_failed_steps_are_rolled_back_and_halved(comm, folder):
    result = solve(PRESS, out=folder)
    assert result.converged
    steps = result.steps
    assert not steps[0]["converged"] and steps[0]["load"] == 1.0
    assert steps[0]["energy"] == pytest.approx(0, abs=1e-14) and steps[0]["volume_ratio"] == 1.0
    kept = 0.0
    for step, after in pairwise(steps):
        if step["converged"]:
            kept = step["load"]
            assert after["load"] > kept
        else:
            assert step["reason"].startswith("DIVERGED")
            assert after["load"] == pytest.approx((kept + step["load"]) / 2)
    assert steps[-1]["load"] == 1.0 and steps[-1]["converged"]
    comm.barrier()
    times = re.findall(r'timestep="([^"]+)"', (folder / "fields.pvd").read_text())
    done = [step["load"] for step in steps if step["converged"]]
    assert [float(t) for t in times] == pytest.approx([0.0, *done])
    comm.barrier()
    gradually = solve(PRESS, steps=8, predictor="extrapolate")
    assert all(step["converged"] for step in gradually.steps)
    assert steps[-1]["energy"] == pytest.approx(gradually.steps[-1]["energy"], rel=1e-9)


@mpi
def test_a_run_that_cannot_go_on_keeps_what_it_has(comm, folder):
    """Two Newton iterations are enough for small steps only, and not for these."""
    result = solve("twist", cells=2, angle=3.0, out=folder, petsc={"snes_max_it": 1})
    comm.barrier()
    found = record(folder)
    assert not result.converged and found["converged"] is False
    assert found["status"] == result.status
    assert re.fullmatch(
        r"stopped at load 0: a step of 1/64 of the nominal one still fails \(DIVERGED_MAX_IT\)",
        found["status"],
    )
    assert [step["load"] for step in found["steps"]] == [2.0**-k for k in range(1, 8)]
    assert {step["reason"] for step in found["steps"]} == {"DIVERGED_MAX_IT"}
    assert len(rows(folder)) == 7 and not result.problem.x.norm()
    assert result.problem.load == 0
    comm.barrier()


def test_the_program_says_so_by_its_exit_code(tmp_path):
    words = ["run", "twist", "--cells", "2", "--out", str(tmp_path), "--", "-snes_max_it", "1"]
    done = subprocess.run(
        [*program(1), *words], env=environment(), capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 1 and "stopped at load 0" in done.stdout and not done.stderr
    assert record(tmp_path)["converged"] is False


# --- interruption --------------------------------------------------------------------------------


@pytest.mark.parametrize("ranks", [1, 2])
@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
def test_an_interrupted_run_leaves_its_record(tmp_path, ranks, name):
    """run.json can be read at any time, and says how it ended."""
    words = ["run", "stretch", "--cells", "8", "--steps", "200", "--quiet", "--out", str(tmp_path)]
    process = subprocess.Popen(
        [*program(ranks), *words], env=environment(), stderr=subprocess.PIPE, text=True
    )
    seen, late = 0, time.monotonic() + 60
    try:
        while seen < 2 and time.monotonic() < late:
            assert process.poll() is None
            time.sleep(0.01)
            if (tmp_path / "run.json").exists():  # readable whenever we look
                found = record(tmp_path)
                seen = len(found.get("steps", []))
                assert found.get("status", "running") == "running"
        process.send_signal(getattr(signal, name))
        _, errors = process.communicate(timeout=20)
    finally:
        process.kill()
    found = record(tmp_path)
    assert seen >= 2 and len(found["steps"]) >= seen and not found["converged"]
    assert len(rows(tmp_path)) >= seen
    assert process.returncode != 0 and "Traceback" not in errors
    assert found["status"] == "interrupted"  # mpirun waits a second, then kills
    if ranks == 1:
        assert process.returncode == 130
        assert errors.strip() == "fem-snh: error: interrupted; what was computed is kept"
        pvd = (tmp_path / "fields.pvd").read_text()
        assert pvd.count("<DataSet") == len(found["steps"]) + 1 and "</VTKFile>" in pvd


# --- ranks ---------------------------------------------------------------------------------------


@mpi
@pytest.mark.parametrize("scene", ["twist", "stretch", "pull"])
@pytest.mark.parametrize(
    "hessian, petsc",
    [
        # Jacobi knows nothing of ranks; sweeps are within each, so that loose solves are others.
        ("adaptive", {"pc_type": "jacobi"}),
        ("adaptive", {"ksp_rtol": 1e-8, "snes_forcing_max": 0}),
        # Its many linearly convergent steps feel the rounding of loose linear solves.
        ("clamp", {"pc_type": "jacobi", "ksp_rtol": 1e-8, "snes_forcing_max": 0}),
    ],
)
def test_any_number_of_ranks_gives_the_same_run(comm, scene, hessian, petsc):
    setup = {"cells": 6, "hessian": hessian, "globalization": "linesearch", "petsc": petsc}
    alone = solve(scene, comm=MPI.COMM_SELF, **setup).steps
    together = solve(scene, comm=comm, **setup).steps
    assert [s["newton"] for s in together] == [s["newton"] for s in alone]
    assert [s["clamped"] for s in together] == [s["clamped"] for s in alone]
    for key, bound in (("energy", 1e-9), ("volume_ratio", 1e-6), ("min_J", 1e-4)):
        values = [s[key] for s in alone]
        assert [s[key] for s in together] == pytest.approx(values, rel=bound)


# --- stored numbers ------------------------------------------------------------------------------

RUNS = {
    f"{scene} {element} {material}": {
        "scene": scene,
        "element": element,
        "material": material,
        "cells": {"Q1": 6, "P2": 4}[element],
        # Loose solves depend on the order of the nodes, and that on dolfinx.
        "petsc": {"snes_forcing_max": 0.0, "ksp_rtol": 1e-8},
    }
    for scene in ("pull", "stretch", "twist")
    for element in ("Q1", "P2")
    # Those of the paper's comparison; what is special to a material is in its kernels, and those
    # are tested point by point.
    for material in ("fixed_corotational", "neo_hookean", "stable_neo_hookean")
}


def numbers(setup):
    """What is stored of a run: its converged steps."""
    result = solve(**setup)
    assert result.converged
    keys = ("load", "newton", "energy", "volume_ratio", "min_J")
    return [{key: step[key] for key in keys} for step in result.steps if step["converged"]]


@pytest.mark.parametrize("name", RUNS)
def test_numbers_are_those_stored(name):
    """Energies to 1e-8, volume ratios to 1e-6, Newton counts within 1."""
    stored = json.loads(STORED.read_text()).get(name)
    assert stored, f"run this file to store {name}"
    found = numbers(RUNS[name])
    assert [s["load"] for s in found] == [s["load"] for s in stored]
    for key, bound in (("energy", 1e-8), ("volume_ratio", 1e-6), ("min_J", 1e-4)):
        assert [s[key] for s in found] == pytest.approx([s[key] for s in stored], rel=bound)
    difference = np.array([s["newton"] for s in found]) - [s["newton"] for s in stored]
    assert abs(difference).max() <= 1


# --- scenes of one's own -------------------------------------------------------------------------


def bar(**kwargs):
    return {
        "name": "bar",
        "element": "Q1",
        "steps": 2,
        "material": MaterialChoice(name="neo_hookean", E=10.0, nu=0.3),
        "hold": [
            Hold(group="left", components=("x",)),
            Hold(group="front", components=("y",)),
            Hold(group="bottom", components=("z",)),
        ],
    } | kwargs


@mpi
def test_a_scene_made_in_python(comm):
    result = solve(
        Scene(
            **bar(
                mesh=Geometry(source="cube"),
                cells=2,
                move=[Move(group="right", components=("x",), translate=(0.4, 0, 0))],
            )
        ),
        nu=0.0,  # overrides count
    )
    assert result.converged and result.record["material"]["nu"] == 0
    assert result.u.name == "displacement" and result.problem.load == 1
    u = result.u.x.array.reshape(-1, 3)
    X = result.problem.V.tabulate_dof_coordinates()
    assert u[:, 0] == pytest.approx(0.4 * X[:, 0], abs=1e-6)
    # nu = 0: eq. 5 has no volume term, and each stretch is on its own
    assert abs(u[:, 1:]).max() < 1e-6


def own_mesh(path, scale=1.0):
    """The unit cube as a user's .msh, with numbered and named groups."""
    with gmsh_input._session() as gmsh:
        gmsh.onelab.setNumber("cells", [2.0])
        gmsh.open(str(gmsh_input.source_path("cube")))
        gmsh.model.mesh.generate(3)
        gmsh.option.setNumber("Mesh.ScalingFactor", scale)
        gmsh.write(str(path))


@mpi
@pytest.mark.parametrize("nu", [0.0, 0.3, 0.49])
@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_a_toml_scene_with_traction_is_linear_elasticity_when_small(comm, folder, nu, scale):
    """u = t L / E along the bar and -nu t L / E across it, at any scale."""
    E, t = 1e6, 1e2
    on_root(comm, own_mesh, folder / "block.msh", scale)
    if comm.rank == 0:
        (folder / "own.toml").write_text(f"""
            mesh = "block.msh"
            element = "Q1"
            steps = 2
            hold = [
              {{ group = "left", components = ["x"] }},
              {{ group = "front", components = ["y"] }},
              {{ group = "bottom", components = ["z"] }},
            ]
            [material]
            name = "stable_neo_hookean"
            E = {E}
            nu = {nu}
            [[traction]]
            group = "right"
            vector = [{t}, 0, 0]
            [petsc]
            snes_scaled_tol = 1e-10
            ksp_rtol = 1e-8
        """)
    comm.barrier()
    result = solve(folder / "own.toml")
    assert result.converged and result.record["terms"] == ["elastic", "traction"]
    u = result.u.x.array.reshape(-1, 3)
    expected = t / E * result.problem.V.tabulate_dof_coordinates() * [1, -nu, -nu]
    assert abs(u - expected).max() <= 1e-3 * t / E * scale


@mpi
@pytest.mark.parametrize("globalization", GLOBALIZATIONS)
def test_size_and_stiffness_are_units_to_a_toml_scene(comm, folder, globalization):
    """A millimetre of steel takes the Newton and linear iterations of a metre of jelly.

    In a trust region linear solves are in double precision: its matrices are nearly singular, and
    the single precision of the default solver changes a tenth of the iterations.
    """
    petsc = {"ksp_type": "cg", "pc_type": "jacobi"} if globalization == "trust_region" else {}
    found = []
    for name, scale, E in (("large", 1.0, 1.0), ("small", 1e-3, 1e6)):
        on_root(comm, own_mesh, folder / f"{name}.msh", scale)
        scene = bar(
            mesh=folder / f"{name}.msh",
            material=MaterialChoice(name="stable_neo_hookean", E=E, nu=0.49),
            hold=[Hold(group="bottom")],
            move=[
                Move(
                    group="top",
                    translate=(0, 0, 0.2 * scale),
                    rotate=Rotate(axis=(0, 0, 1), through=(0.5 * scale,) * 3, angle=1.0),
                )
            ],
            petsc=petsc,
        )
        found.append(solve(Scene(**scene), globalization=globalization).steps)
    for one, other in zip(*found, strict=True):
        assert [one[k] for k in ("newton", "clamped", "reason")] == [
            other[k] for k in ("newton", "clamped", "reason")
        ]
        assert other["linear"] == pytest.approx(one["linear"], abs=2)
        assert other["energy"] / (1e6 * 1e-9) == pytest.approx(one["energy"], rel=1e-8)


@mpi
def test_petsc_options_of_a_scene_end_with_it_and_yield_to_the_command_lines(comm):
    database = PETSc.Options(solver.PREFIX)
    petsc = {"ksp_type": "minres", "snes_max_it": 150}
    result = solve("twist", cells=1, angle=0.1, petsc=petsc)
    assert result.record["linear_solver"] == "minres+jacobi"
    assert not database.hasName("ksp_type")
    database["ksp_type"] = "cr"
    try:
        result = solve("twist", cells=1, angle=0.1, petsc=petsc)
        assert result.record["linear_solver"] == "cr+jacobi"
        assert database.getString("ksp_type") == "cr" and not database.hasName("snes_max_it")
    finally:
        database.delValue("ksp_type")


@pytest.mark.mpi
def test_multigrids_preconditioner_is_definite_for_filtered_matrices(comm):
    """Symmetric sweeps are; PETSc's own polynomial need not be, and then every step fails."""
    settings = {"element": "Q2", "cells": 4, "nu": 0.3, "progress": False}
    found = fem_snh.run("stretch", **settings, petsc={"pc_type": "gamg"})
    assert found.converged and len(found.steps) == 12
    assert max(step["linear"] / step["newton"] for step in found.steps) < 10
    assert not PETSc.Options(solver.PREFIX).hasName("mg_levels_ksp_type")


if __name__ == "__main__":
    print(json.dumps({name: numbers(setup) for name, setup in RUNS.items()}, indent=1))
