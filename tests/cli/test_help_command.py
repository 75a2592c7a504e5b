"""`fem-snh help`: every key and every material, in the words of the schema that validates them."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from fem_snh import cli
from fem_snh.cli import help as reference
from fem_snh.scenes import Obstacle, Scene


def printed(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert cli.main(["help", *words]) == 0
    return " ".join(capsys.readouterr().out.split())


def test_a_table_has_all_its_keys(capsys: pytest.CaptureFixture[str]) -> None:
    text = printed(capsys, "scene.obstacle")
    for key, field in Obstacle.model_fields.items():
        assert f"{key} " in text and field.description.rstrip(".") in text
    assert text == printed(capsys, "obstacle") == printed(capsys, "[[obstacle]]")


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("obstacle.friction", "obstacle.friction Coulomb's coefficient of friction. "
         "Expected: a number >= 0; default: 0.0."),
        ("move.0.translate", "Expected: three finite numbers, [x, y, z]."),
        ("shape.sphere", "radius The radius [length]. Expected: a number > 0; required."),
        ("time.integrator", "Expected: one of backward_euler, newmark,"),
        ("damping", "time.damping"),
        ("fields", "von_mises sqrt(3/2 s : s)"),
        ("material", "nu Poisson's ratio at small strain"),
        ("material.ogden", "exponents The exponents a_p."),
        ("plot", "usage: fem-snh plot"),
    ],
)  # fmt: skip
def test_one_key(words: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert text in printed(capsys, words)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ("obstcle", "unknown key or material 'obstcle': .*did you mean 'obstacle'"),
        ("obstacle.frction",
         "obstacle: unknown key 'frction': expected one of shape, .*'friction'"),
        ("material.ogdn", "did you mean 'ogden'"),
        ("encastre", r"did you mean \[\[hold\]\]"),
        ("", "unknown key or material ''"),
        ("obstacle friction", "unexpected 'friction'"),
    ],
)  # fmt: skip
def test_mistakes(words: str, message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["help", *(words.split() or [""])]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and re.search(message, error), error


def test_every_table_is_found() -> None:
    """Found by pydantic's own walk over the schema."""
    tables = {table.__name__ for key in reference.every_key() for table in key.tables}
    assert tables == set(Scene.model_json_schema()["$defs"])


@pytest.mark.one_debian
def test_help_imports_no_solver() -> None:
    code = (
        "import sys; from fem_snh import cli; cli.main(['help', 'obstacle']); print(*sys.modules)"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert "pydantic" in loaded
    assert not loaded & {"petsc4py", "mpi4py", "dolfinx", "ufl", "gmsh", "sympy"}
