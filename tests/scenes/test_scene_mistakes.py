"""Mistakes in a scene: each is one line that names the key, its value and what is accepted."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from scene_file import TOML

from fem_snh import scenes
from fem_snh.errors import BadInput

pytestmark = pytest.mark.one_debian

MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"nu": 0.51}, r"material.nu = 0.51: expected a number in \(-1, 0.5\]"),
    ({"nu": float("nan")}, r"material.nu = nan: expected a number in \(-1, 0.5\]"),
    ({"E": 0}, "material.E = 0: expected a number from 1e-100 to 1e\\+100"),
    ({"E": float("inf")}, "material.E = inf: expected a number from 1e-100 to 1e\\+100"),
    ({"probe": [{"name": "a", "point": [0, 0, 0]}] * 2},
     "probe.name = 'a': expected a different name for each probe"),
    ({"material": "neo_hookan"},
     "material.name = 'neo_hookan': expected .*did you mean 'neo_hookean'"),
    ({"material": {"nam": "neo_hookean"}},
     "unknown parameter 'nam': expected .*did you mean 'name'"),
    ({"integrator": "newmark"}, r"unknown .*\(did you mean 'time\.integrator'\?\)"),
    ({"friction": 0.3}, r"did you mean 'obstacle\.0\.friction'\?"),
    ({"angel": 1.0}, "unknown parameter 'angel': expected .*steps.*did you mean 'angle'"),
    ({"scene": "x"}, "unknown parameter 'scene'"),
    ({"angle": "x"}, "angle = 'x': expected a number"),
    ({"angle": float("inf")}, "angle = inf: expected a finite number"),
    ({"material.barier": True}, "unknown parameter 'barier': expected .*did you mean 'barrier'"),
    ({"material.alpah": 2},
     "unknown parameter 'alpah': expected .*lambda_part.*did you mean 'alpha'"),
    ({"material.alpha": 0}, "material.alpha = 0.0: expected a number from 0.01 to 16"),
    ({"material.alpha_mu": "x"}, "material.alpha_mu = 'x': expected a finite number"),
    ({"material.alpha": float("inf")}, "material.alpha = inf: expected a finite number"),
    ({"material.epsilon": -1},
     "material.epsilon = -1.0: expected 0 or a number from 0.0001 to 0.99"),
    ({"material.lambda_part": "stbl_neo_hookean"},
     "lambda_part = .*: expected one of .*did you mean 'stable_neo"),
    ({"material.lambda_part": 3}, "material.lambda_part = 3: expected the name of a material"),
    ({"material.mu": 3}, "unknown parameter 'mu'"),
    ({"reactions": [1.5]}, r"reactions = \[1.5\]: expected a list of names or numbers"),
    ({"material.barrier": 3}, "material.barrier = 3: expected true or false"),
    ({"move.0.rotat": 1},
     "move.0: unknown key 'rotat': expected .*translate.*did you mean 'rotate'"),
    ({"move.0.rotate.axis": [0, 0, 0]},
     "move.0.rotate.axis = .*: expected a vector that is not zero"),
    ({"move.0.rotate": None},
     "move.0: missing key 'translate' or 'rotate': expected one of them, or both"),
    ({"move.3.group": "x"}, "unknown key 'move.3.group'"),
    ({"material.nu.x": 1}, "unknown key 'material.nu.x'"),
    ({"hold.0.group": "top"},
     "move.group = 'top': expected components other than x, y, z, which \\[\\[hold"),
    ({"hold": [3]}, "hold.0 = 3: expected a table"),
    ({"hold": [{"group": "top", "table": "on"}]},
     r"hold.0.table = 'on': expected no table: a \[\[hold\]\] lasts for the whole run"),
    ({"petsc.ksp": {}}, "petsc = .*: expected a table of"),
    ({"mesh": "x.msh"}, "cells = 15: expected no value, as x.msh has its own"),
]  # fmt: skip


@pytest.mark.parametrize(("overrides", "message"), MISTAKES, ids=[str(m[0]) for m in MISTAKES])
def test_mistake_in_one_line(overrides: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=f"^twist: .*{message}") as caught:
        scenes.load("twist", **overrides)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("steps = 4", "step = 4", "unknown key 'step': expected .*did you mean 'steps'"),
        ("steps = 4", "steps = 4 4", r"not valid TOML: .*line 4"),
        ("steps = 4", "cells = 4", "cells = 4: expected no value, as block.msh has its own"),
        ('mesh = "block.msh"', "", "missing key 'mesh': expected path of a gmsh file"),
        ('mesh = "block.msh"', "mesh = 3", "mesh = 3: expected a gmsh file, an XDMF file or"),
        ("nu = 0.49", "", r"material: missing key 'nu': expected a number in \(-1, 0.5\]"),
        ("vector = [0, 6.25, 0]", "", "traction.0: missing key 'vector': expected three"),
        ("[[hold]]", "[hold]", "hold = .*expected a list of tables"),
        ('"left"', '""', "hold.0.group = '': expected the name of a physical group, or its number"),
        ("angle = 1.57", "angle = nan", "move.0.rotate.angle = nan: expected a finite number"),
    ],
)
def test_mistake_in_a_scene_file(toml: Path, old: str, new: str, message: str) -> None:
    assert old in TOML
    toml.write_text(TOML.replace(old, new))
    with pytest.raises(BadInput, match=rf"block\.toml.*{message}") as caught:
        scenes.load(toml)
    assert "\n" not in str(caught.value)


def test_no_such_scene(toml: Path) -> None:
    with pytest.raises(BadInput, match=r"scene = 'twst': expected .*toml.*did you mean 'twist'"):
        scenes.load("twst")
    with pytest.raises(BadInput, match=r"blok.toml: No such file.* .did you mean 'block.toml'"):
        scenes.load(toml.with_name("blok.toml"))
    toml.write_bytes(b"\xff\xfe")
    with pytest.raises(BadInput, match="not UTF-8"):
        scenes.load(toml)
    with pytest.raises(BadInput, match="cannot read"):
        (toml.parent / "folder.toml").mkdir()
        scenes.load(toml.parent / "folder.toml")
