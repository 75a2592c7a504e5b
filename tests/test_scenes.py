"""Scenes: every one that exists, scene files, overrides, moves, and how mistakes are told."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import expm

from fem_snh import materials, scenes
from fem_snh.errors import BadInput, RenamedKey
from fem_snh.scenes import Hold, Move, Rotate, Scene

TOML = """
mesh = "block.msh"
element = "P2"
steps = 4
quadrature = 4
[material]
name = "stable_neo_hookean"
E = 1e4
nu = 0.49
barrier = true
[[hold]]
group = "left"
components = ["x"]
[[move]]
group = 7
rotate = { axis = [1, 0, 0], through = [0, 0, 0], angle = 1.57 }
[[traction]]
group = "top"
vector = [0, 6.25, 0]
[[probe]]
name = "tip"
point = [1, 0.5, 0]
[petsc]
-ksp_rtol = 1e-6
snes_monitor = true
"""


@pytest.fixture
def toml(tmp_path: Path) -> Path:
    path = tmp_path / "block.toml"
    path.write_text(TOML)
    return path


# --- every scene ---------------------------------------------------------------------------------


@pytest.mark.parametrize("name", scenes.names())
def test_scene_is_named_after_its_file_and_described(name: str) -> None:
    assert scenes.load(name).name == name
    assert scenes.describe(name).endswith(".")


@pytest.mark.parametrize("element", ["Q1", "P1"])
@pytest.mark.parametrize("name", scenes.names())
def test_groups_of_a_scene_are_in_its_mesh(name: str, element: str, comm: Any) -> None:
    from fem_snh.fem.elements import ELEMENTS
    from fem_snh.fem.mesh import generate

    scene = scenes.load(name, cells=4, element=element)
    assert isinstance(scene.mesh, scenes.Geometry)
    cell = ELEMENTS[scene.element].cell
    mesh = generate(comm, scene.mesh.source, cell, cells=scene.cells, **scene.mesh.parameters)
    groups = [c.group for c in (*scene.hold, *scene.move, *scene.traction)]
    for group in (*groups, *scene.reactions):
        assert mesh.group(group).count > 0


@pytest.mark.parametrize("name", scenes.names())
def test_probes_of_a_scene_are_in_its_mesh(name: str, comm: Any) -> None:
    from fem_snh import _dolfinx
    from fem_snh.fem.elements import ELEMENTS
    from fem_snh.fem.mesh import generate
    from fem_snh.fem.probes import Probes

    scene = scenes.load(name, cells=4)
    assert isinstance(scene.mesh, scenes.Geometry)
    cell = ELEMENTS[scene.element].cell
    mesh = generate(comm, scene.mesh.source, cell, cells=scene.cells, **scene.mesh.parameters)
    u = _dolfinx.function(_dolfinx.function_space(mesh.domain, 1, (3,)), "u")
    assert list(Probes(u, scene.probe).values()) == [probe.name for probe in scene.probe]


@pytest.mark.parametrize("name", scenes.names())
def test_scene_survives_a_round_trip(name: str) -> None:
    scene = scenes.load(name)
    assert Scene.model_validate(scene.model_dump()) == scene


# --- overrides -----------------------------------------------------------------------------------


def test_overrides_reach_every_level() -> None:
    scene = scenes.load(
        "twist",
        nu=np.float32(0.25),
        cells=np.int64(3),
        angle=1.0,
        element="P2",
        steps=None,
        petsc={"-ksp_rtol": 1e-4, "snes_view": None},
        **{"material.barrier": True, "move.0.rotate.through": np.zeros(3), "petsc.a.b": 1},
    )
    assert (scene.material.nu, scene.cells, scene.element, scene.steps) == (0.25, 3, "P2", 2)
    assert scene.material.parameters == {"barrier": True}
    rotate = scene.move[0].rotate
    assert rotate is not None and rotate.angle == 1.0 and rotate.through == (0, 0, 0)
    added = {"ksp_rtol": 1e-4, "snes_view": None, "a.b": 1}
    assert scene.petsc == scenes.load("twist").petsc | added


def test_a_scene_can_be_overridden_again() -> None:
    scene = scenes.load(scenes.load("twist", **{"material.barrier": True}), cells=4)
    assert scene.cells == 4 and scene.material.parameters == {"barrier": True}


def test_another_material_drops_the_shape_parameters_of_the_first(toml: Path) -> None:
    assert scenes.load(toml).material.parameters == {"barrier": True}
    other = scenes.load(toml, material="neo_hookean").material
    assert (other.name, other.E, other.nu, other.parameters) == ("neo_hookean", 1e4, 0.49, {})
    assert scenes.load(toml, material="stable_neo_hookean").material.parameters


def test_what_any_material_takes_beside_its_own() -> None:
    tuning = {
        "material.alpha_mu": 2,
        "material.alpha_lambda": np.float64(0.5),
        "material.lambda_part": "neo_hookean",
        "material.epsilon": 0,
        "material.alpha": None,
    }
    assert {key.partition(".")[2] for key in tuning} == set(materials.TUNING)
    given = scenes.load("twist", **{"material.barrier": True}, **tuning).material.parameters
    assert given == {
        "barrier": True,
        "alpha": None,
        "alpha_mu": 2.0,
        "alpha_lambda": 0.5,
        "lambda_part": "neo_hookean",
        "epsilon": 0.0,
    }
    assert isinstance(given["alpha_mu"], float)


def test_tuning_of_a_scene_file(toml: Path) -> None:
    toml.write_text(TOML.replace("barrier = true", 'alpha = 2\nlambda_part = "neo_hookean"'))
    assert scenes.load(toml).material.parameters == {"alpha": 2.0, "lambda_part": "neo_hookean"}
    assert scenes.load(toml, material="neo_hookean").material.parameters == {}


@pytest.fixture
def parametrised() -> Any:
    """A function: a material of many constants and of shape parameters of every kind."""

    def many(  # type: ignore[no-untyped-def]
        I_C,
        J,
        C1: Any = 0.1,
        C2: Any = 0.05,
        kappa: Any = 1.0,
        *,
        powers: tuple[float, ...] = (1.0,),
        volume: str = "J",
        n: float = 2.0,
        terms: int | None = None,
    ):
        """Many."""

    return many


def test_parameters_of_every_kind(parametrised: Any) -> None:
    table = {"name": parametrised, "powers": [1, 2.5], "volume": "log", "n": 3, "C2": 0, "terms": 2}
    table |= {"E": 1.0, "nu": 0.3}
    given = scenes.load("twist", material=table).material.parameters
    assert given == {"powers": (1.0, 2.5), "volume": "log", "n": 3.0, "C2": 0.0, "terms": 2}
    also = scenes.load("twist", material=table | {"powers": np.array([1.5])})
    assert also.material.parameters["powers"] == (1.5,)
    assert Scene.model_validate(also.model_dump()) == also


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("powers", 2.0, r"powers = 2.0: expected a list of float"),
        ("powers", ["a"], r"powers = \['a'\]: expected a list of float"),
        ("powers", [float("nan")], r"powers = \[nan\]: expected a list of float"),
        ("volume", 1, "volume = 1: expected str"),
        ("n", "x", "n = 'x': expected float"),
        ("n", True, "n = True: expected float"),
        ("terms", 2.5, "terms = 2.5: expected int or None"),
        ("C2", "x", "C2 = 'x': expected float or None"),
        (
            "C3",
            1.0,
            "unknown parameter 'C3': expected .*C1, C2, kappa, alpha.*did you mean 'C[12]'",
        ),
    ],
)
def test_mistakes_in_parameters(parametrised: Any, key: str, value: Any, told: str) -> None:
    with pytest.raises(BadInput, match=f"^twist: material: .*{told}"):
        scenes.load("twist", material={"name": parametrised, key: value})


def test_scene_file(toml: Path) -> None:
    scene = scenes.load(str(toml))
    assert (scene.name, scene.mesh) == ("block", toml.parent / "block.msh")
    assert scene.hold[0].components == ("x",) and scene.move[0].group == 7
    assert scene.petsc == {"ksp_rtol": 1e-6, "snes_monitor": True}
    assert scene.traction[0].vector == (0, 6.25, 0)
    assert (scene.quadrature, scene.eigensolver) == (4, "cubic")
    assert (scene.probe[0].name, scene.probe[0].point) == ("tip", (1, 0.5, 0))


# --- moves ---------------------------------------------------------------------------------------

VECTOR = st.tuples(*[st.floats(-2, 2)] * 3).map(np.array)


@given(VECTOR.filter(lambda v: np.linalg.norm(v) > 1e-3), st.floats(-7, 7), VECTOR, st.floats(0, 1))
def test_rotation_is_the_exponential(axis: Any, angle: float, through: Any, load: float) -> None:
    X = np.random.default_rng(0).standard_normal((5, 3))
    turn = Move(group=1, rotate=Rotate(axis=axis, angle=angle, through=through))
    k = load * angle * axis / np.linalg.norm(axis)
    R = expm(np.array([[0, -k[2], k[1]], [k[2], 0, -k[0]], [-k[1], k[0], 0]]))
    np.testing.assert_allclose(
        X + turn.displacement(X, load), through + (X - through) @ R.T, atol=1e-13
    )


def test_a_quarter_turn_is_right_handed() -> None:
    turn = Move(group=1, rotate=Rotate(axis=(0, 0, 2), angle=np.pi / 2, through=(1, 0, 0)))
    X = np.array([[2.0, 0.0, 5.0], [1.0, 0.0, 0.0]])
    np.testing.assert_allclose(X + turn.displacement(X, 1), [[1, 1, 5], [1, 0, 0]], atol=1e-15)


def test_a_move_turns_first_and_shifts_then() -> None:
    rotate = Rotate(axis=(0, 0, 1), angle=np.pi / 2)
    both = Move(group=1, rotate=rotate, translate=(1, 0, 0))
    X = np.array([[1.0, 0.0, 0.0]])
    np.testing.assert_allclose(X + both.displacement(X, 1), [[1, 1, 0]], atol=1e-15)
    apart = Move(group=1, rotate=rotate), Move(group=1, translate=(1, 0, 0))
    total = sum(move.displacement(X, 0.3) for move in apart)
    np.testing.assert_allclose(both.displacement(X, 0.3), total, atol=1e-15)


def test_nothing_moves_at_load_zero_or_when_held() -> None:
    X = np.random.default_rng(1).standard_normal((4, 3))
    move = Move(group=1, rotate=Rotate(axis=(1, 2, 3), angle=2), translate=(1, 0, 0))
    assert np.abs(move.displacement(X, 0)).max() < 1e-15
    assert not Hold(group=1).displacement(X, 1).any()


# --- mistakes ------------------------------------------------------------------------------------

MISTAKES: list[tuple[dict[str, Any], str]] = [
    ({"nu": 0.51}, r"material.nu = 0.51: expected a number in \(-1, 0.5\]"),
    ({"nu": float("nan")}, r"material.nu = nan: expected a number in \(-1, 0.5\]"),
    ({"nu": "x"}, r"material.nu = 'x': expected a number in \(-1, 0.5\]"),
    ({"E": 0}, "material.E = 0: expected a number > 0"),
    ({"E": float("inf")}, "material.E = inf: expected a number > 0"),
    ({"cells": 0}, "cells = 0: expected a whole number, 1 or more"),
    ({"cells": 1.5}, "cells = 1.5: expected a whole number"),
    ({"cells": True}, "cells = True: expected a whole number"),
    ({"steps": 0}, "steps = 0: expected a whole number, 1 or more"),
    ({"element": "Q3"}, "element = 'Q3': expected .*P1.*did you mean 'Q.'"),
    ({"element": 3}, "element = 3: expected one of .*P1"),
    ({"quadrature": 0}, "quadrature = 0: expected a whole number, 1 or more"),
    ({"quadrature": 2.0}, "quadrature = 2.0: expected a whole number"),
    ({"eigensolver": "cubik"}, "eigensolver = 'cubik': expected .*jacobi.*did you mean 'cubic'"),
    ({"probe": [{"point": [0, 0, 0]}]}, "probe.0: missing key 'name': expected a name"),
    ({"probe": [{"name": "a"}]}, "probe.0: missing key 'point': expected three finite numbers"),
    ({"probe": [{"name": "a", "point": [0, 0]}]}, "probe.0.point = .*: expected three finite"),
    ({"probe": [{"name": "a", "point": [0, 0, 0]}] * 2}, "two probes are called 'a'"),
    ({"probe": {"name": "a"}}, "probe = .*: expected a list of tables"),
    ({"hessian": "clmp"}, "hessian = 'clmp': expected .*adaptive.*did you mean 'clamp'"),
    ({"predictor": "tangnt"}, "predictor = 'tangnt': expected .*did you mean 'tangent'"),
    ({"material": "neo_hookan"}, "material = 'neo_hookan': expected .*did you mean 'neo_hookean'"),
    (
        {"material": {"nam": "neo_hookean"}},
        "unknown parameter 'nam': expected .*did you mean 'name'",
    ),
    ({"angel": 1.0}, "unknown parameter 'angel': expected .*steps.*did you mean 'angle'"),
    ({"scene": "x"}, "unknown parameter 'scene'"),
    ({"angle": "x"}, "angle = 'x': expected a number"),
    ({"angle": float("inf")}, "angle = inf: expected a finite number"),
    ({"material.barier": True}, "unknown parameter 'barier': expected .*did you mean 'barrier'"),
    (
        {"material.alpah": 2},
        "unknown parameter 'alpah': expected .*lambda_part.*did you mean 'alpha'",
    ),
    ({"material.alpha": 0}, "material: alpha = 0.0: expected a number > 0"),
    ({"material.alpha_mu": "x"}, "material: alpha_mu = 'x': expected float or None"),
    ({"material.alpha": float("inf")}, "material: alpha = inf: expected float or None"),
    ({"material.epsilon": -1}, "material: epsilon = -1.0: expected a number >= 0"),
    (
        {"material.lambda_part": "stbl_neo_hookean"},
        "lambda_part = .*: expected one of .*did you mean 'stable_neo",
    ),
    ({"material.lambda_part": 3}, "material: lambda_part = 3: expected the name of a material"),
    ({"material.mu": 3}, "unknown parameter 'mu'"),
    ({"reactions": "top"}, "reactions = 'top': expected a list of names or numbers"),
    ({"reactions": [1.5]}, r"reactions = \[1.5\]: expected a list of names or numbers"),
    ({"material.barrier": 3}, "material: barrier = 3: expected bool or None"),
    (
        {"move.0.rotat": 1},
        "move.0: unknown key 'rotat': expected .*translate.*did you mean 'rotate'",
    ),
    ({"move.0.rotate": {"axis": [0, 0, 1]}}, "move.0.rotate: missing key 'angle': expected a fin"),
    ({"move.0.rotate.axis": [0, 0, 0]}, "move.0.rotate.axis: .* has no direction"),
    ({"move.0.rotate.axis": [0, 1]}, r"move.0.rotate.axis = \[0, 1\]: expected three finite"),
    ({"move.0.rotate": None}, "move.0: a move needs 'translate', 'rotate' or both"),
    ({"move.0.components": ["u"]}, "move.0.components = .*: expected a list of 'x', 'y', 'z'"),
    ({"move.3.group": "x"}, "cannot set 'move.3.group'"),
    ({"material.nu.x": 1}, "cannot set 'material.nu.x'"),
    ({"hold.0.group": "top"}, "group 'top' is both held and moved in x, y, z"),
    ({"hold": 3}, r"hold = 3: expected a list of tables, \[\[...\]\]"),
    ({"hold": [3]}, "hold.0 = 3: expected a table"),
    ({"traction": [{"group": "top", "vector": [1, 2]}]}, "traction.0.vector = .* three finite"),
    ({"petsc.ksp": {}}, "petsc = .*: expected a table of"),
    ({"mesh": "x.msh"}, "cells = 15: only a built-in geometry has it.*x.msh"),
    ({"mesh": {"sorce": "cube"}}, "mesh: unknown key 'sorce': expected .*did you mean 'source'"),
    ({"load_range": [1]}, "load_range = .1.: expected two finite numbers"),
]


@pytest.mark.parametrize(("overrides", "told"), MISTAKES, ids=[str(m[0]) for m in MISTAKES])
def test_mistake_in_one_line(overrides: dict[str, Any], told: str) -> None:
    with pytest.raises(BadInput, match=f"^twist: .*{told}") as caught:
        scenes.load("twist", **overrides)
    assert "\n" not in str(caught.value)


def test_held_and_moved_in_different_components_is_fine() -> None:
    overrides = {"hold.0.group": "top", "hold.0.components": ["z"], "move.0.components": ["x", "y"]}
    scenes.load("twist", **overrides)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("steps = 4", "step = 4", "unknown key 'step': expected .*did you mean 'steps'"),
        ("steps = 4", "steps = 4 4", r"not valid TOML: .*line 4"),
        ("steps = 4", "cells = 4", "cells = 4: only a built-in geometry has it"),
        ('mesh = "block.msh"', "", "missing key 'mesh'"),
        ('mesh = "block.msh"', "mesh = 3", "mesh = 3: expected a gmsh file or"),
        ("nu = 0.49", "", r"material: missing key 'nu': expected a number in \(-1, 0.5\]"),
        ("vector = [0, 6.25, 0]", "", "traction.0: missing key 'vector': expected three"),
        ("[[hold]]", "[hold]", "hold = .*expected a list of tables"),
        ('"left"', '""', "hold.0.group = '': expected the name or number"),
        ("angle = 1.57", "angle = nan", "move.0.rotate.angle = nan: expected a finite number"),
    ],
)
def test_mistake_in_a_scene_file(toml: Path, old: str, new: str, told: str) -> None:
    assert old in TOML
    toml.write_text(TOML.replace(old, new))
    with pytest.raises(BadInput, match=rf"block\.toml.*{told}") as caught:
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


def test_the_old_name_of_a_key_is_accepted_with_a_note(toml: Path) -> None:
    with pytest.warns(RenamedKey, match="'soften' is accepted and now called 'nu_continuation'"):
        assert scenes.load("twist", soften=[0.3]).nu_continuation == [0.3]
    toml.write_text(TOML.replace("steps = 4", "soften = [0.1]"))
    with pytest.warns(RenamedKey, match="nu_continuation"):
        assert scenes.load(toml).nu_continuation == [0.1]
