"""Any value for any key of a scene gives a Scene or one line; every key is described."""

from __future__ import annotations

from typing import Any, get_args

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from pydantic import BaseModel

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.scenes import Scene

pytestmark = pytest.mark.one_debian

HUGE = 99999999999999999999

# --- any value -----------------------------------------------------------------------------------

WORDS = st.sampled_from(
    ["", "x", "Q1", "top", "exact", "\0", "neo_hookean", "a\nb", "gent.py:gent"]
)
NUMBERS = (
    st.integers()
    | st.sampled_from([0, 1, -1, HUGE, -HUGE, 10**400, 2**31, 2**63])
    | st.floats()
    | st.sampled_from([1e300, -1e300, 5e-324])
)
VALUES: st.SearchStrategy[Any] = st.recursive(
    WORDS | st.text() | NUMBERS | st.booleans() | st.none() | st.datetimes(),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(WORDS | st.sampled_from(["group", "name", "source"]), inner, max_size=3)
    ),
    max_leaves=6,
)


def keys(model: type[BaseModel] = Scene, table: str = "") -> list[str]:
    """The dotted keys of all tables; 0 for the first of a list."""
    found = []
    for name, field in model.model_fields.items():
        found.append(f"{table}{name}")
        lists = getattr(field.annotation, "__origin__", None) is list
        for kind in (field.annotation, *get_args(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                found += keys(kind, f"{table}{name}.0." if lists else f"{table}{name}.")
    return found


#: A scene that has every table.
WHOLE = scenes.load(
    "twist", predictor="none", modes={}, start={"map": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]},
    traction=[{"group": "left", "vector": [1, 0, 0]}], **{"move.0.translate": [1, 0, 0]},
)  # fmt: skip


@pytest.mark.parametrize("key", keys())
@settings(max_examples=25)
@given(value=VALUES)
@example(value=HUGE)
@example(value=[HUGE, float("nan"), 10**400])
def test_any_value_gives_a_scene_or_one_line(key: str, value: Any) -> None:
    try:
        assert isinstance(scenes.load(WHOLE, **{key: value}), Scene)
    except BadInput as error:
        assert str(error).startswith("twist: ") and len(str(error).splitlines()) == 1


@given(st.dictionaries(st.sampled_from(list(Scene.model_fields)) | WORDS, VALUES, max_size=4))
def test_any_table_gives_a_scene_or_one_line(table: dict[str, Any]) -> None:
    data = WHOLE.model_dump() | table
    try:
        assert isinstance(scenes.validate(data, "twist"), Scene)
    except BadInput as error:
        assert str(error).startswith("twist: ") and len(str(error).splitlines()) == 1


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("start.seed", HUGE, f"start.seed = {HUGE}: expected a whole number from 0 to "),
        ("hold.0.group", HUGE, f"hold.0.group = {HUGE}: expected the name of a physical group, or"),
        ("petsc.snes_max_it", HUGE, "expected a table of numbers (whole ones of 32 bits)"),
        ("petsc.snes_max_it", str(HUGE), "expected a table of numbers (whole ones of 32 bits)"),
        ("petsc.a", "1, -2147483648", "expected a table of numbers (whole ones of 32 bits)"),
        ("petsc", {"-": 1}, "expected the name of a PETSc option"),
        ("mesh.parameters.cells", 10**400, "mesh.parameters = "),
        ("mesh", "a\0.msh", "mesh = 'a\\x00.msh': expected a gmsh file"),
        ("material.E", 10**400, "material.E = 1000"),
        ("load_range", [0, 10**400], "load_range = [0, 1000"),
    ],
)
def test_numbers_out_of_range(key: str, value: Any, message: str) -> None:
    with pytest.raises(BadInput) as caught:
        scenes.load(WHOLE, **{key: value})
    assert message in str(caught.value)
