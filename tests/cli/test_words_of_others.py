"""Words of other programs in a scene, and scenes and lists as one types them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

import fem_snh
from fem_snh import cli, materials, scenes
from fem_snh.errors import BadInput
from fem_snh.scenes import Scene
from fem_snh.tables.validation import words_of_others

WORDS: list[tuple[dict[str, Any], str]] = [
    ({"displacement": 1}, r"unknown parameter 'displacement': .*did you mean \[\[move\]\] or \[\["),
    ({"fix": 1}, r"unknown parameter 'fix': .*did you mean \[\[hold\]\]"),
    ({"encastre": 1}, r"did you mean \[\[hold\]\]"),
    ({"face_impo": 1}, r"did you mean \[\[hold\]\]"),
    ({"pres_rep": 1}, r"did you mean \[\[pressure\]\]"),
    ({"body_force": 1}, r"did you mean \[gravity\]"),
    ({"traction": [{"pressure": 1}]}, r"traction.0: unknown key 'pressure': .*\[\[pressure\]\]"),
    ({"traction": [{"force": 1}]}, "traction.0: unknown key 'force': .*did you mean 'vector'"),
    ({"pressure": [{"magnitude": 1}]}, "unknown key 'magnitude': .*did you mean 'value'"),
    ({"hold": [{"surface": "a"}]}, "hold.0: unknown key 'surface': .*did you mean 'group'"),
    ({"move": [{"value": 1}]}, "unknown key 'value': .*did you mean 'translate'"),
    ({"barrier": True}, r"unknown parameter 'barrier': .*did you mean \[material\]"),
    ({"move": [{"displacement": 1}]}, "unknown key 'displacement': .*did you mean 'translate'"),
    ({"material.Young": 1}, "unknown parameter 'Young': .*did you mean 'E'"),
    ({"material.rho": 1}, "unknown parameter 'rho': .*did you mean 'density'"),
    ({"mesh": {"file": "a.msh"}}, "mesh: unknown key 'file': .*did you mean mesh = 'FILE'"),
    ({"time": {"end-time": 1}}, "unknown key 'end-time': .*did you mean 'duration'"),
]


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"viscoelastic": 1}, r"\(there is no viscoelasticity: 'damping' of \[time\] has "),
        ({"swelling": 1}, r"\(there is no swelling .*: in a program an energy in UFL may have it"),
        ({"membrane": True}, r"\(there are solids alone: .*'plane_stress', whose forces are per"),
        ({"material.prony": 1}, r"\(there is no viscoelasticity: "),
        ({"material.thermal_expansion": 1}, r"\(there is no swelling"),
    ],
)
def test_what_is_not_there_is_said_so(tables: dict[str, Any], message: str) -> None:
    for name, value in tables.items():
        with pytest.raises(BadInput, match=message) as caught:
            scenes.load("twist", **{name: value})
        assert "did you mean" not in str(caught.value)


@pytest.mark.parametrize(("tables", "message"), WORDS, ids=[str(w[0]) for w in WORDS])
def test_the_word_of_this_program(tables: dict[str, Any], message: str) -> None:
    with pytest.raises(BadInput, match=message) as caught:
        scenes.load("twist", **tables)
    assert "\n" not in str(caught.value)


def test_synonyms_are_of_keys_that_exist() -> None:
    """Every name that a message suggests is a table or a key of the schema."""
    keys: set[str] = set(Scene.model_fields)
    schema = Scene.model_json_schema()
    for table in schema["$defs"].values():
        keys |= set(table.get("properties", {}))
    named = {name for entry in words_of_others()["names"] for name in entry["here"]}
    assert {name.partition(" = ")[0].strip("[]") for name in named} <= keys
    for name in named:
        if name.startswith("["):
            kind = schema["properties"][name.strip("[]")]
            assert name.startswith("[[") == (kind.get("type") == "array"), name


def test_a_scene_file_without_its_suffix(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "mounting.toml").write_text("steps = 1\n")
    for name in ("mounting", "mountin"):
        assert cli.main(["run", name]) == 2
        assert f"scene = '{name}': expected" in (error := capsys.readouterr().err)
        assert "did you mean 'mounting.toml'" in error


def test_lists_with_commas() -> None:
    found = scenes.load(
        "twist", reactions="top, bottom", volumes="3", **{"move.0.components": "x,y"}
    )
    assert [reaction.group for reaction in found.reactions] == ["top", "bottom"]
    assert found.volumes == ["3"]
    assert found.move[0].components == ("x", "y")
    moved = scenes.load("twist", **{"move.0.translate": "0,0, 0.1"}).move[0]
    assert moved.translate == (0.0, 0.0, 0.1)
    with pytest.raises(BadInput, match="translate = '0;0;1': expected three finite numbers"):
        scenes.load("twist", **{"move.0.translate": "0;0;1"})
    with pytest.raises(BadInput, match=r"reactions = \['a', ''\]: expected a list of names"):
        scenes.load("twist", reactions="a,")


@pytest.mark.one_debian("ranks")
@pytest.mark.mpi
@pytest.mark.parametrize(
    ("key", "group", "where"),
    [("hold.0.group", "botom", "hold.0.group"), ("reactions", ["botom"], "reactions")],
)
def test_the_key_of_an_unknown_group(key: str, group: Any, where: str) -> None:
    message = rf"{where} = 'botom': no physical group 'botom' in the mesh \(did you mean 'bottom'\?"
    with pytest.raises(BadInput, match=message):
        fem_snh.run("twist", cells=1, progress=False, **{key: group})


def test_public_names_are_listed() -> None:
    """`dir` lists the public names alone, and every one of them exists."""
    for module in (fem_snh, materials):
        assert dir(module) == sorted(module.__all__)
        assert all(hasattr(module, name) for name in dir(module))
