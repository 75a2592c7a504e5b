"""[[material]] of a scene: the file, replaced values, the output, and mistakes on every rank."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mpi4py import MPI

import pytest
from running import solve
from scene_file import TWO_MATERIALS

from fem_snh import scenes
from fem_snh.errors import BadInput


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "bar.toml"
    path.write_text(TWO_MATERIALS)
    return path


def test_values_are_replaced_in_all_materials_or_in_one(file: Path) -> None:
    assert [m.group for m in scenes.load(file).materials] == ["second", None]
    assert [m.density for m in scenes.load(file).materials] == [3000.0, None]
    given = {"material.1.E": 7.0, "material.alpha": 2.0, "nu": 0.4}
    found = scenes.load(file, **given).materials
    assert [(m.E, m.nu, m.parameters) for m in found] == [
        (4.0, 0.4, {"alpha": 2.0}), (7.0, 0.4, {"alpha": 2.0})
    ]  # fmt: skip
    other = scenes.load(scenes.load(file, **given), material="neo_hookean_ogden").materials
    assert [(m.name, m.E, m.group, m.parameters) for m in other] == [
        ("neo_hookean_ogden", 4.0, "second", {}), ("neo_hookean_ogden", 7.0, None, {})
    ]  # fmt: skip
    assert [m.nu for m in scenes.load(file, nu=0.2).materials] == [0.2, 0.2]


def test_run_and_resume(file: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    modes = {"count": 7, "density": 1000.0}
    given: dict[str, Any] = {"steps": 2, "nu_continuation": [0.35], "comm": MPI.COMM_SELF}
    solve(file, out=out, modes=modes, **given)
    record = json.loads((out / "run.json").read_text())
    first, second = record["material"]
    assert (first["name"], first["group"], first["density"]) == (
        "stable_neo_hookean", "second", 3000.0
    )  # fmt: skip
    assert second["name"] == "neo_hookean" and "group" not in second and record["converged"]
    assert record["modes"]["mass"] == pytest.approx(3000 + 1000, rel=1e-12)
    # The modulus that the tolerance is relative to: that of the two halves in a row.
    problem = solve(file, out=out, modes=modes, resume=True, **given).problem
    assert problem.modulus == pytest.approx(2 / (1 / 4 + 1 / 1), rel=1e-12)
    with pytest.raises(BadInput, match=r"material\.1\.E = 2\.0: expected 1\.0 as before"):
        solve(file, out=out, modes=modes, resume=True, **given, **{"material.1.E": 2.0})
