"""What a run leaves: run.json, steps.csv, fields, and the folder."""

from __future__ import annotations

import json
from contextlib import closing
from time import sleep

from mpi4py import MPI

import numpy as np
import pytest
from running import record, rows, solve

import fem_snh
from fem_snh import _dolfinx
from fem_snh.errors import BadInput
from fem_snh.runs.folder import COLUMNS, Folder

mpi = pytest.mark.mpi


KEYS = {
    "scene", "material", "element", "hessian", "globalization", "terms", "cells", "dofs", "ranks",
    "converged", "status", "steps", "seconds", "peak_memory_mb", "versions", "load_name",
    "load_range", "quadrature", "defaults",
}  # fmt: skip


@pytest.mark.one_debian("ranks")
@mpi
def test_the_record_says_what_was_solved_and_how(comm, folder):
    result = solve("twist", cells=3, angle=0.6, out=folder / "new" / "run")
    folder = folder / "new" / "run"
    found = record(folder)
    assert set(found) >= KEYS
    values = result.problem.regions[0].material.expression.values
    assert found["material"] == {
        "name": "stable_neo_hookean", "E": 1.0, "nu": 0.49,
        "mu_lame": pytest.approx(1 / 2.98, rel=1e-10),
        "lambda_lame": pytest.approx(0.49 / (1.49 * 0.02), rel=1e-10),
        "parameters": {"mu": values[0], "lam": values[1], "barrier": False},
        "equation": "eq. 13 of Smith et al. 2018",
    }  # fmt: skip
    expected = {
        "scene": "twist", "element": "Q1", "hessian": "adaptive", "globalization": "trust_region",
        "terms": ["elastic"], "cells": 27, "dofs": 192, "ranks": comm.size, "status": "converged",
    }  # fmt: skip
    assert {key: found[key] for key in expected} == expected
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


@pytest.mark.one_debian
@mpi
@pytest.mark.parametrize("element", ["Q1", "P2"])
def test_fields_are_read_by_pyvista(comm, folder, element):
    import pyvista

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
    import pyvista

    result = solve("pull", cells=2, steps=2, material="filtered_neo_hookean", out=folder)
    comm.barrier()
    assert result.converged and not result.problem.has_energy
    assert [step["energy"] for step in result.steps] == [None, None]
    assert [step["energy"] for step in record(folder)["steps"]] == [None, None]
    assert [row["energy"] for row in rows(folder)] == ["", ""]
    assert all(row["residual"] and row["right.force.x"] for row in rows(folder))
    reader = pyvista.get_reader(str(folder / "fields.pvd"))
    reader.set_active_time_value(1.0)
    names = set(reader.read().combine().cell_data.keys())
    assert names & {"J", "energy_density", "min_eigenvalue"} == {"J", "min_eigenvalue"}
    with pytest.raises(BadInput, match="material 'filtered_neo_hookean' has no energy"):
        result.problem.energy(result.problem.x)
    comm.barrier()


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (
            {},
            {
                "hessian": ("adaptive", "positive definite"),
                "globalization": ("trust_region", "minimises an energy"),
                "linear_solver": ("cg+ssor", "iterations cost less"),
                "quadrature": (3, "degree of Q1"),
            },
        ),
        ({"hessian": "clamp", "quadrature": 3, "petsc": {"pc_type": "jacobi"}},
         {"globalization": ("linesearch", "the Hessian was chosen")}),
        ({"element": "Q2Q1", "hessian": "exact", "globalization": "linesearch"},
         {"linear_solver": ("", "an unknown pressure"), "quadrature": (5, "degree of Q2Q1")}),
    ],
)  # fmt: skip
def test_the_programs_own_choices_have_reasons(values, expected):
    result = fem_snh.run(
        "twist", comm=MPI.COMM_SELF, cells=2, steps=1, angle=0.2, progress=False, **values
    )
    found = result.record["defaults"]
    assert set(found) == set(expected)
    for key, (value, reason) in expected.items():
        assert reason in found[key]["reason"]
        assert found[key]["value"] == (value or result.record[key]) == result.record[key]


def test_numbers_of_steps_are_those_of_json(tmp_path):
    """A step is a line; numpy's numbers are Python's, and infinity and NaN null."""
    steps = [
        {"load": np.float64(0.1), "newton": np.int64(3), "of": [np.float32(0.5), True]},
        {"load": 1.0, "residual": np.inf, "of": {"energy": np.float64("nan")}},
    ]
    modes = {"steps": [], "frequencies": [], "residuals": []}
    with closing(Folder(MPI.COMM_SELF, tmp_path / "run")) as folder:
        for written in ([], steps):
            folder.write({"a": np.nan, "steps": written, "modes": modes, "z": 1})
            found = json.loads(
                (tmp_path / "run" / "run.json").read_text(), parse_constant=pytest.fail
            )
            assert list(found) == ["a", "steps", "modes", "z", "files"]
            assert found["a"] is None and found["modes"] == modes
            assert len(found["steps"]) == len(written)
    first, last = found["steps"]
    assert first == {"load": 0.1, "newton": 3, "of": [0.5, True]}
    assert last == {"load": 1.0, "residual": None, "of": {"energy": None}}
    assert f"\n  {json.dumps(first)}," in (tmp_path / "run" / "run.json").read_text()


def test_the_seconds_of_jit_are_of_all_that_is_compiled(monkeypatch, tmp_path):
    """Spaces and forms of the setup, of fields, of the estimate and of notes: in no other part."""
    plain, slept = _dolfinx.forms.fem.form, []

    def slow(*arguments, **keys):
        slept.append(0.1)
        sleep(slept[-1])
        return plain(*arguments, **keys)

    keys = {"cells": 2, "steps": 1, "fields": ["von_mises"], "error": True}
    solve("twist", out=tmp_path / "first", **keys)
    monkeypatch.setattr(_dolfinx.forms.fem, "form", slow)
    found = solve("twist", out=tmp_path / "second", **keys).record
    seconds = dict(found["seconds"])
    total, jit = seconds.pop("total"), seconds.pop("jit")
    assert len(slept) > 2 and jit > sum(slept)
    assert all(value >= 0 for value in seconds.values()) and sum(seconds.values()) + jit <= total
    assert sum(seconds.values()) < total - sum(slept)
    assert seconds["estimate"] == pytest.approx(
        found["estimate"]["seconds"] - found["estimate"]["jit"]
    )


def test_a_petsc_option_that_no_solver_has_is_a_note():
    found = solve("twist", cells=1, steps=1, petsc={"snes_maxx_it": 3, "ksp_max_it": 90})
    (note,) = (note for note in found.record["notes"] if note["kind"] == "options")
    assert note["names"] == ["-snh_snes_maxx_it"]
