"""Values and PETSc options on the command line."""

from __future__ import annotations

import pytest

from fem_snh.cli import options
from fem_snh.errors import BadInput

pytestmark = pytest.mark.one_debian


@pytest.mark.parametrize(
    ("text", "meaning"),
    [
        ("1e-3", 1e-3), ("-2", -2), (".5", 0.5), ("true", True), ("False", False),
        ("[1, 0, 0]", [1, 0, 0]), ('"3"', "3"), ("Q1", "Q1"), ("", ""), ("a b", "a b"),
        ('[{group = "top", about = [0, 0, 1]}]', [{"group": "top", "about": [0, 0, 1]}]),
        ('[{"group": "top", "about": [0, 0, 1]}]', [{"group": "top", "about": [0, 0, 1]}]),
        ('{"a": {"b": [true, null]}}', {"a": {"b": [True, None]}}),
    ],
)  # fmt: skip
def test_value(text: str, meaning: object) -> None:
    found = options.value(text)
    assert found == meaning and type(found) is type(meaning)


@pytest.mark.parametrize("text", ["[1, 0", '[{"group": top}]', "{a: 1}"])
def test_a_list_or_table_is_toml_or_json(text: str) -> None:
    with pytest.raises(BadInput, match=r"^fields = .*: expected a list or a table in TOML or JSON"):
        options.value(text, "fields")


def test_petsc_words() -> None:
    words = "run twist -- -snes_view -ksp_rtol 1e-6 --mg_levels_pc_type jacobi -a -1".split()
    rest, petsc = options.split_petsc(words)
    assert rest == ["run", "twist"]
    expected = {"snes_view": None, "ksp_rtol": "1e-6", "mg_levels_pc_type": "jacobi", "a": "-1"}
    assert petsc == expected
    with pytest.raises(BadInput, match=r"'2' after --: expected PETSc options"):
        options.split_petsc(["--", "-a", "1", "2"])
