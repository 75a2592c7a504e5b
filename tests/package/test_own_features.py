"""Features of another package: an entry point, in scenes, programs, results, fields and help."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from paths import ROOT

import fem_snh
from fem_snh.errors import BadInput

PAGE = ROOT / "docs/howto/own_term.md"
FEATURE = '''
from typing import ClassVar

from fem_snh.records.output_fields import VECTOR, OutputField
from fem_snh.terms.feature import Feature
from fem_snh.tables.types import FilePath, Positive


class Bed(Feature):
    """Springs throughout the body."""

    key = "bed"
    nodal_fields: ClassVar = {"bed_force": OutputField("force of the bed", "Pa", VECTOR)}
    stiffness: Positive
    data: FilePath | None = None

    @classmethod
    def describe(cls, features, terms):
        return {"beds": [bed.stiffness for bed in features]}

    def create_term(self, body):
        from bed import BedTerm

        class Recorded(BedTerm):
            def record(term, u):
                return {"beds": {"body": {"energy": term.energy(u)}}}

            def nodal_field(term, name, u):
                with u.localForm() as local:
                    return -self.stiffness * local.array_r.reshape(-1, 3)

        return Recorded(body.V, self.stiffness)
'''
SCENE = """
element = "Q1"
cells = 1
fields = ["bed_force"]
mesh = { source = "cube" }
gravity = { vector = [0, 0, -1] }
bed = [{ stiffness = 4 }, { stiffness = 6 }]
[material]
name = "stable_neo_hookean"
E = 1.0
nu = 0.4
density = 2
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A folder on the path with a package that declares the feature `bed`, and two broken ones."""
    term = re.search(r"```python\n# bed.py\n(.*?)```", PAGE.read_text(), re.DOTALL)
    assert term
    (tmp_path / "bed.py").write_text(term[1])
    (tmp_path / "beds.py").write_text(FEATURE)
    (tmp_path / "sunk.toml").write_text(SCENE)
    info = tmp_path / "beds-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: beds\nVersion: 1.0\n")
    points = ["bed = beds:Bed", "broken = no_such_module:Bed", "other = beds:Bed", "cells = x:Bed"]
    (info / "entry_points.txt").write_text("\n".join(["[fem_snh.features]", *points, ""]))
    return tmp_path


def python(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run Python in a folder that is on its path."""
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    env = os.environ | {"PYTHONPATH": path}
    return subprocess.run(
        [sys.executable, *words], cwd=folder, env=env, capture_output=True, text=True
    )


CHECK = """
import json
import numpy as np
import pyvista
record = json.load(open("out/run.json"))
assert record["terms"] == ["elastic", "gravity", "bed", "bed"] and record["beds"] == [4, 6], record
beds = record["steps"][-1]["beds"]  # two rows of one name
energies = [beds[name]["energy"] for name in ("body", "body_2")]
assert np.allclose(energies, [4 / 2 * 0.2**2, 6 / 2 * 0.2**2], atol=1e-9), beds
last = pyvista.get_reader("out/fields.pvd")
last.set_active_time_value(last.time_values[-1])
force = last.read()[0]["bed_force"]
assert np.allclose(force, [0, 0, 10 * 0.2], atol=1e-6), force  # of both beds
"""

PROGRAM = """
import numpy as np, ufl, fem_snh
from beds import Bed
from dolfinx import fem, mesh
from mpi4py import MPI
domain = mesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1, mesh.CellType.hexahedron)
made = hasattr(fem, "functionspace")
kind = "Lagrange", 1
V = fem.functionspace(domain, (*kind, (3,))) if made else fem.VectorFunctionSpace(domain, kind)
u, m = fem.Function(V), fem_snh.material("stable_neo_hookean", E=1.0, nu=0.4)
terms = [Bed(4), fem_snh.Gravity([0, 0, -1]), Bed(6)]
problem = fem_snh.NonlinearProblem(u, {m: ufl.dx}, terms=terms, densities={m: 2.0})
problem.solve()
assert np.allclose(u.x.array.reshape(-1, 3), [0, 0, -2 / 10], atol=1e-9), u.x.array
"""


def test_an_entry_point_in_a_scene_and_a_program(package: Path) -> None:
    """A body in its bed sinks by rho g / k as a whole."""
    done = python(package, "-m", "fem_snh", "run", "sunk.toml", "--out", "out", "--quiet")
    assert done.returncode == 0, done.stderr
    assert "entry point 'cells' of fem_snh.features is no table" in done.stderr
    for code in (CHECK, PROGRAM):
        done = python(package, "-c", code)
        assert done.returncode == 0, done.stderr


@pytest.mark.one_debian
def test_files_of_a_feature_start_from_the_folder_of_the_scene(package: Path) -> None:
    """A resumed run compares their contents, as those of the program's own features."""
    inner = package / "inner"
    inner.mkdir()
    (inner / "bed.csv").write_text("1")
    (inner / "s.toml").write_text(SCENE.replace("stiffness = 4", 'stiffness = 4, data = "bed.csv"'))
    run = ["-m", "fem_snh", "run", "inner/s.toml", "--out", "out", "--quiet"]
    done = python(package, *run)
    assert done.returncode == 0, done.stderr
    (inner / "bed.csv").write_text("2")
    done = python(package, *run, "--resume")
    assert done.returncode == 2 and 'bed.0.data = "sha256' in done.stderr, done.stderr


def test_help_and_mistakes(package: Path) -> None:
    done = python(package, "-m", "fem_snh", "run", "--help")
    assert "bed" in done.stdout.partition("keys and tables of a scene")[2].replace(",", "").split()
    code = """
from fem_snh import scenes
from fem_snh.errors import BadInput
def mistake(**changes):
    try:
        scenes.load("sunk.toml", **changes)
    except BadInput as error:
        return str(error)
print(mistake(bed=[{"stiffness": -1}]))
print(mistake(bed=[{}]))
print(mistake(bed=[]))
print(mistake(broken=[1]))
print(mistake(other=[1]))
print(mistake(beds=[1]))
"""
    done = python(package, "-c", code)
    lines = done.stdout.splitlines()
    assert "bed.0.stiffness = -1: expected a number > 0" in lines[0], done.stderr
    assert "bed.0: missing key 'stiffness'" in lines[1]
    assert "fields = 'bed_force': expected another field, as the scene has no [[bed]]" in lines[2]
    assert "broken = no_such_module:Bed of the package beds: ModuleNotFoundError" in lines[3]
    assert "expected a feature with the key 'other'" in lines[4]
    assert "unknown" in lines[5] and "did you mean 'bed'" in lines[5]


def test_what_is_no_feature() -> None:
    class Unnamed(fem_snh.Feature):
        """A feature without a key."""

    class Taken(fem_snh.Feature):
        """A feature with the key of another."""

        key = "pressure"

    for feature, expected in (
        (3, "feature = 3: expected a subclass of fem_snh.Feature"),
        (Unnamed, "Unnamed.key = None: expected the key of a table"),
        (Taken, "Taken.key = 'pressure': expected"),
    ):
        with pytest.raises(BadInput, match=re.escape(expected)):
            fem_snh.register_feature(feature)
