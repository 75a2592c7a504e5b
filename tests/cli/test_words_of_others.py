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


def test_public_names_are_listed() -> None:
    """`dir` lists the public names alone, and every one of them exists."""
    for module in (fem_snh, materials):
        assert dir(module) == sorted(module.__all__)
        assert all(hasattr(module, name) for name in dir(module))
