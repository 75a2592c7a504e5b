"""Materials of the user's own: functions, ``FILE.py:FUNCTION`` and entry points."""

from __future__ import annotations

import csv
import importlib
import json
import os
from pathlib import Path

import numpy as np
import pytest
from sympy import log

import fem_snh
from fem_snh import BadInput, cli, materials, references, scenes

GENT = '''
from sympy import log


def gent(I_C, J, mu, lam, *, J_m: float = 20.0):
    """Gent 1996, with a logarithmic volume term.

    ::

        psi = -mu J_m/2 log(1 - (I_C - 3)/J_m) - mu log J + lam/2 (log J)^2
    """
    length = -mu * J_m / 2 * log(1 - (I_C - 3) / J_m)
    return length - mu * log(J) + lam / 2 * log(J) ** 2
'''
SCENE = """
mesh = { source = "block" }
cells = 2
element = "Q1"
steps = 1
[material]
name = "gent.py:gent"
E = 1e4
nu = 0.4
J_m = 30.0
[[hold]]
group = "bottom"
[[move]]
group = "top"
translate = [0, 0, 0.1]
"""
F = np.eye(3) + 0.2 * np.random.default_rng(0).standard_normal((6, 3, 3))


def gent(I_C, J, mu, lam, *, J_m=20.0):
    length = -mu * J_m / 2 * log(1 - (I_C - 3) / J_m)
    return length - mu * log(J) + lam / 2 * log(J) ** 2


@pytest.fixture
def file(folder: Path) -> Path:
    """A file with the function gent, in a folder that all ranks share."""
    path = folder / "gent.py"
    if not path.exists():
        path.write_text(GENT)
    return path


@pytest.fixture
def here(file: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory, which holds gent.py."""
    monkeypatch.chdir(file.parent)
    return file.parent


# --- pointwise -----------------------------------------------------------------------------------


@pytest.mark.one_debian
def test_a_function_is_normalised_like_a_built_in_material():
    m = fem_snh.material(gent, E=2.0, nu=0.3, J_m=15.0)
    assert m.name == "gent" and m.expression.shape == {"J_m": 15.0}
    assert m.lame == pytest.approx(fem_snh.material("neo_hookean", E=2.0, nu=0.3).lame, rel=1e-12)
    mu, lam = m.expression.values
    I_C, J = (F**2).sum((1, 2)), np.linalg.det(F)
    psi = -mu * 15 / 2 * np.log(1 - (I_C - 3) / 15) - mu * np.log(J) + lam / 2 * np.log(J) ** 2
    assert m.energy(F) == pytest.approx(psi, rel=1e-12)
    assert np.linalg.eigvalsh(m.hessian(F, filter="clamp")).min() > -1e-12 * m.expression.E


@pytest.mark.one_debian
def test_a_reference_is_the_same_material(here: Path):
    m = fem_snh.material("gent.py:gent", E=2.0, nu=0.3)
    assert m.name == "gent.py:gent"
    assert (m.energy(F) == fem_snh.material(gent, E=2.0, nu=0.3).energy(F)).all()
    assert materials.describe("gent.py:gent").startswith("Gent 1996")
    assert materials.defaults("gent.py:gent") == {"J_m": 20.0}


# --- runs ----------------------------------------------------------------------------------------


@pytest.mark.mpi
def test_run_and_resume_of_a_scene_file(comm, file: Path):
    scene, out = file.parent / "press.toml", file.parent / "out"
    if comm.rank == 0:
        scene.write_text(SCENE)
    comm.barrier()
    assert fem_snh.run(scene, out=out, progress=False).converged
    material = json.loads((out / "run.json").read_text())["material"]
    assert material["name"] == "gent.py:gent" and material["parameters"]["J_m"] == 30.0
    assert fem_snh.run(scene, out=out, resume=True, progress=False).converged
    with pytest.raises(BadInput, match=r"cannot resume .*material.name = \"neo_hookean\""):
        fem_snh.run(scene, out=out, resume=True, progress=False, material="neo_hookean")
    comm.barrier()
    if comm.rank == 0:
        file.write_text(GENT.replace("20.0", "25.0"))
        os.utime(file, ns=(0, 0))
    comm.barrier()
    with pytest.raises(BadInput, match=r"cannot resume .*material.name = \"sha256"):
        fem_snh.run(scene, out=out, resume=True, progress=False)


def test_a_scene_keeps_what_was_given(file: Path):
    path = file.parent / "press.toml"
    path.write_text(SCENE)
    scene = scenes.load(path)
    assert scene.material.label == "gent.py:gent" and scene.material.files == {"name": file}
    again = scenes.load(scene, nu=0.3)
    assert again.material.files == {"name": file} and again.material.parameters == {"J_m": 30.0}
    assert scenes.load(scene, material=gent).model_dump(mode="json")["material"]["name"] == "gent"
    path.write_text(SCENE.replace("J_m = 30.0", 'lambda_part = "gent.py:gent"'))
    assert scenes.load(path).material.files == {"name": file, "lambda_part": file}


# --- the command line ----------------------------------------------------------------------------


def test_run_and_sweep(here: Path, capsys: pytest.CaptureFixture[str]):
    words = "--cells 2 --steps 1 --set angle=0.3 --nu 0.4".split()
    run = ["run", "twist", "--material", "gent.py:gent", "--out", "a", "--quiet"]
    assert cli.main([*run, *words]) == 0
    assert json.loads(Path("a/run.json").read_text())["material"]["name"] == "gent.py:gent"
    sweep = ["sweep", "twist", "--material", "gent.py:gent,neo_hookean", "--out", "b"]
    assert cli.main([*sweep, *words]) == 0
    with open("b/sweep.csv") as table:
        assert {row["material"] for row in csv.DictReader(table)} == {"gent.py:gent", "neo_hookean"}
    with pytest.raises(BadInput, match="material: expected names or references"):
        from fem_snh.studies.sweep import sweep as study

        study("twist", "c", {"material": [gent]})


# --- entry points --------------------------------------------------------------------------------


@pytest.fixture
def installed(here: Path, monkeypatch: pytest.MonkeyPatch):
    """A package with the entry points ``gel`` (a material) and ``broken`` (none)."""
    info = here / "gels-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: gels\nVersion: 1.0\n")
    points = ["gel = gent:gent", "broken = no_such_module:gel", "neo_hookean = gent:gent"]
    (info / "entry_points.txt").write_text("\n".join(["[fem_snh.materials]", *points, ""]))
    monkeypatch.syspath_prepend(str(here))
    importlib.invalidate_caches()
    references.entry_points.cache_clear()
    yield
    references.entry_points.cache_clear()


def test_entry_points(installed, capsys: pytest.CaptureFixture[str]):
    assert {"gel", "broken", "neo_hookean"} <= set(fem_snh.materials())
    m = fem_snh.material("gel", nu=0.3)
    assert m.name == "gel"
    assert (m.energy(F) == fem_snh.material(gent, nu=0.3).energy(F)).all()
    assert "J_m" not in materials.defaults("neo_hookean")  # the built-in one takes precedence
    with pytest.raises(BadInput, match="broken = no_such_module:gel"):
        fem_snh.material("broken")
    assert cli.main(["materials"]) == 0
    listed = capsys.readouterr().out
    assert "gel" in listed and "no_such_module" in listed
    assert scenes.load("twist", material="gel").material.label == "gel"
