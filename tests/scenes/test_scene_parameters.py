"""Shape parameters of a scene's material: their types and their mistakes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from fem_snh import scenes
from fem_snh.errors import BadInput
from fem_snh.scenes import Scene

pytestmark = pytest.mark.one_debian


def many(
    I_C, J, C1=0.1, C2=0.05, kappa=1.0, *, powers: tuple[float, ...] = (1.0,), volume: str = "J",
    n: float = 2.0, terms: int | None = None, pairs: list[float] = [],
):  # fmt: skip
    """A material of many constants and of shape parameters of every kind."""


def test_parameters_of_every_kind() -> None:
    table = {"name": many, "powers": [1, 2.5], "volume": "log", "n": 3, "C2": 0, "terms": 2}
    table |= {"E": 1.0, "nu": 0.3, "pairs": (1, 2)}
    given = scenes.load("twist", material=table).material.parameters
    assert given == {
        "powers": (1.0, 2.5), "volume": "log", "n": 3.0, "C2": 0.0, "terms": 2, "pairs": [1, 2]
    }  # fmt: skip
    also = scenes.load("twist", material=table | {"powers": np.array([1.5])})
    assert also.material.parameters["powers"] == (1.5,)
    assert Scene.model_validate(also.model_dump()) == also


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("powers", 2.0, r"powers = 2.0: expected a list of finite numbers"),
        ("powers", ["a"], r"powers = \['a'\]: expected a list of finite numbers"),
        ("powers", [float("nan")], r"powers = \[nan\]: expected a list of finite numbers"),
        ("volume", 1, "volume = 1: expected a text"),
        ("n", "x", "n = 'x': expected a finite number"),
        ("n", True, "n = True: expected a finite number"),
        ("terms", 2.5, "terms = 2.5: expected a whole number"),
        ("C2", "x", "C2 = 'x': expected a finite number"),
        ("C3", 1.0,
         "unknown parameter 'C3': expected .*C1, C2, kappa, alpha.*did you mean 'C[12]'"),
    ],
)  # fmt: skip
def test_mistakes_in_parameters(key: str, value: Any, message: str) -> None:
    with pytest.raises(BadInput, match=f"^twist: material[.:].*{message}"):
        scenes.load("twist", material={"name": many, key: value})
